"""The page of effects says what the classes say."""

import re
from pathlib import Path

from identifiability.cli.main import main
from identifiability.joint.effects import DESCRIPTIONS, EFFECTS
from identifiability.report.effects import effects_page

DOCS = Path(__file__).resolve().parents[1] / "docs"


def test_the_page_is_that_of_the_classes():
    page = (DOCS / "effects.md").read_text(encoding="utf-8")
    assert page == effects_page(EFFECTS, DESCRIPTIONS)
    assert (DOCS / "effects.svg").is_file()


def test_every_effect_is_there_with_its_equation_and_source():
    page = effects_page(EFFECTS, DESCRIPTIONS)
    for kind in (*EFFECTS.values(), *DESCRIPTIONS.values()):
        section = page.split(f"`{kind.key}`; it ")[1].split("\n#")[0]
        assert all(p.description in section for p in kind.parameters)
        assert all(reference in section for reference in kind.references)
    # No markup of docstrings is left, and every equation is closed.
    assert not re.search(r"\.\. math|:math:|``", page)
    assert page.count("$$") % 2 == 0


def test_the_command_lists_them_and_writes_the_page(tmp_path, capsys):
    assert main(["effects"]) == 0
    said = capsys.readouterr().out
    assert all(key in said for key in EFFECTS)
    assert main(["effects", "--out", str(tmp_path / "docs")]) == 0
    assert {p.name for p in (tmp_path / "docs").iterdir()} == {"effects.md", "effects.svg"}
