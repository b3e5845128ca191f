"""The project as a whole: public names, notebooks, documents."""

import ast
import json
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import identifiability

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_every_public_name_is_there_and_documented():
    stub = ast.parse((ROOT / "identifiability" / "__init__.pyi").read_text())
    declared = next(ast.literal_eval(n.value) for n in stub.body if isinstance(n, ast.Assign))
    assert len(set(declared)) == len(declared) > 40
    assert set(declared) == set(identifiability.__all__)
    for name in identifiability.__all__:
        value = getattr(identifiability, name)
        assert isinstance(value, dict) or value.__doc__ or name == "MSM", name


def test_command_line_answers_without_heavy_imports():
    """--help must not wait for the numerical libraries."""
    import subprocess
    import sys

    code = (
        "import sys\n"
        "from identifiability.cli.main import parser\n"
        "parser()\n"
        "heavy = {'jax', 'matplotlib', 'arviz', 'scipy', 'emcee'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_is_kept_with_its_outputs_and_uses_public_names_only(path):
    cells = json.loads(path.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in code)
    assert any("image/png" in o.get("data", {}) for cell in code for o in cell["outputs"])
    assert not any(o["output_type"] == "error" for cell in code for o in cell["outputs"])
    assert path.stat().st_size < 500_000
    source = "\n".join("".join(cell["source"]) for cell in code)
    lines = [line for line in source.splitlines() if not line.startswith("%")]
    for node in ast.walk(ast.parse("\n".join(lines))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("identifiability"):
            assert node.module == "identifiability"
            assert {alias.name for alias in node.names} <= set(identifiability.__all__)


def test_readme_names_every_notebook_and_existing_files():
    text = (ROOT / "README.md").read_text()
    assert len(text.split()) < 900
    for path in NOTEBOOKS:
        assert f"notebooks/{path.name}" in text
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / link).exists(), (page.name, link)


def test_versions_agree():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()


def test_all_modules_import():
    for path in sorted((ROOT / "identifiability").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] not in ("__init__", "__main__"):
            import_module(".".join(parts))
