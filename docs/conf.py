"""The documentation: `sphinx-build -W -c docs . build/docs`, from the project's own pages.

The source is the project itself, so that pages, notebooks and results are read where they are; what
the package exports is documented, name by name.
"""

import inspect
import tomllib
from collections import defaultdict
from pathlib import Path

import identifiability

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project, release = PROJECT["name"], PROJECT["version"]
author = PROJECT["authors"][0]["name"]
copyright = author
root_doc = "docs/index"
include_patterns = ["docs/*.md", "docs/api/**", "notebooks/*.ipynb", "results/*.md", "CHANGELOG.md"]
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx-mathjax-offline",
]
html_theme = "pydata_sphinx_theme"
html_title = project
html_theme_options = {"secondary_sidebar_items": ["page-toc"]}
html_static_path: list[str] = []
html_copy_source = False

nb_execution_mode = "off"  # they are kept with their outputs, and a test runs them
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["mystnb.unknown_mime_type"]

autosummary_generate = True
autodoc_default_options = {"members": True}
autodoc_typehints = "none"  # numpydoc's sections have them
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

FOLDERS = {
    "measurement": "Trials and perturbations",
    "joint": "Models of a joint",
    "inference": "Fits and widths",
    "investigation": "What is missing",
    "workbench": "Steered by hand",
    "study": "The paper and the atlas",
    "benchmark": "Hidden effects",
    "plots": "Figures",
    "report": "Reports",
    "errors": "Errors",
}


def write_reference() -> None:
    """Write the page of all public names, by the folder that they are from."""
    by_folder = defaultdict(list)
    for name in identifiability.__all__:
        thing = getattr(identifiability, name)
        module = inspect.getmodule(thing) or inspect.getmodule(type(thing))
        folder = module.__name__.split(".")[1] if "." in module.__name__ else "joint"
        by_folder[folder if folder in FOLDERS else "joint"].append(name)
    lines = [
        "Reference",
        "=========",
        "",
        "Every public name is imported from ``identifiability``.",
    ]
    for folder, title in FOLDERS.items():
        if folder not in by_folder:
            continue
        lines += ["", title, "-" * len(title), "", ".. currentmodule:: identifiability", ""]
        lines += [".. autosummary::", "   :toctree: .", "", *(f"   {n}" for n in by_folder[folder])]
    page = ROOT / "docs" / "api" / "index.rst"
    page.parent.mkdir(exist_ok=True)
    text = "\n".join(lines) + "\n"
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


write_reference()  # before pages are looked for
