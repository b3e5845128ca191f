"""The page of effects says what the classes say."""

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from identifiability.cli.main import main
from identifiability.joint.effects import DESCRIPTIONS, EFFECTS
from identifiability.plots.effects import look_alikes_figure
from identifiability.plots.joint_scheme import joint_scheme_figure
from identifiability.report.effects import effects_page

DOCS = Path(__file__).resolve().parents[1] / "docs"
FIGURES = ("joint.svg", "effects.svg")


def test_the_page_is_that_of_the_classes():
    page = (DOCS / "effects.md").read_text(encoding="utf-8")
    assert page == effects_page(EFFECTS, DESCRIPTIONS)
    assert all((DOCS / name).is_file() for name in FIGURES)


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
    assert {p.name for p in (tmp_path / "docs").iterdir()} == {"effects.md", *FIGURES}


def test_every_effect_stands_somewhere():
    figure = joint_scheme_figure(EFFECTS)
    (axes,) = figure.axes
    shown = [text.get_text() for text in axes.texts]
    assert all(shown.count(key.replace("_", " ")) == 1 for key in EFFECTS)
    # Nothing lies on anything else, and nothing is cut.
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axes.texts if text.get_text()]
    assert all(figure.bbox.contains(*corner) for box in boxes for corner in box.corners())
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def curves(key):
    """By experiment, what is drawn: by label, of the effect first."""
    for panel in look_alikes_figure(key, EFFECTS).axes:
        yield {one.get_label(): one.get_ydata() for one in panel.lines if one.get_label()[0] != "_"}


@pytest.mark.parametrize("key", ["gravity", "coulomb_friction"])
def test_an_effect_is_drawn_beside_its_look_alikes(key):
    for drawn in curves(key):
        assert list(drawn) == [k.replace("_", " ") for k in (key, *EFFECTS[key].confused_with)]
        for values in drawn.values():
            assert np.max(np.abs(values)) == pytest.approx(1.0)


def test_the_imposed_motion_decides_what_can_be_told_apart():
    """The torque of gravity is a line and a cube of an imposed angle; under a torque both move."""
    torque, angle = curves("gravity")
    for drawn, alike in ((torque, False), (angle, True)):
        apart = np.abs(drawn["gravity"] - drawn["cubic stiffness"])
        assert (np.max(apart) < 0.1) == alike
