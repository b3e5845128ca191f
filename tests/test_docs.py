"""What the pages tell users to write does what they say."""

import doctest
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import Step
from identifiability.measurement.readers.formats import READERS
from identifiability.measurement.readers.trial_file import read_trial
from identifiability.workbench.session import Session

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "identifiability").rglob("*.py")
    if ">>>" in path.read_text(encoding="utf-8")
)


def blocks(page):
    """Python in a page."""
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.S)


def run(code):
    said = {}
    exec(code, said)
    return said


def test_an_effect_of_ones_own():
    effect = run(blocks("extend.md")[0])["library"]["cogging"]
    model, time = KBI() + effect(), np.arange(1000) / 1000
    values = {"K": 30.0, "B": 1.0, "I": 0.1, "cogging.size": 0.5, "cogging.pitch": 0.8}
    drive = Step(amplitude=6.0).drive(time)
    held = simulate(model, model.vector(values), drive)
    free = simulate(KBI(), KBI().vector({k: values[k] for k in "KBI"}), drive)
    assert free[-1] == pytest.approx(0.2, rel=1e-2)
    # Where it rests both together carry 6 Nm; a quarter pitch from the tooth is 0.2 rad.
    assert 30 * held[-1] + 0.5 * np.sin(2 * np.pi * held[-1] / 0.8) == pytest.approx(6.0, rel=1e-2)


def test_a_reader_of_ones_own(tmp_path):
    before = dict(READERS)
    try:
        run(blocks("extend.md")[1])
        angle = np.sin(np.arange(50.0))
        np.stack([np.degrees(angle), 2 * angle], axis=1).tofile(tmp_path / "knee.pairs")
        trial = read_trial(tmp_path / "knee.pairs", rate=1000.0)
        np.testing.assert_allclose(trial.angle, angle)
        np.testing.assert_allclose(trial.torque, 2 * angle)
    finally:
        READERS.clear()
        READERS.update(before)


def test_a_session_has_what_the_page_says():
    (code,) = blocks("your_own_data.md")
    names = set(re.findall(r"session\.(\w+)", code))
    assert {"rank", "add", "undo", "compare"} <= names
    assert not [name for name in names if not hasattr(Session, name)]


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_of_docstrings_say_what_they_say(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = dict(READERS)
    try:
        source = (ROOT / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8")
        assert "+SKIP" not in source
        failed, tried = doctest.testmod(
            importlib.import_module(module), optionflags=doctest.ELLIPSIS
        )
        assert tried
        assert not failed
    finally:
        READERS.clear()
        READERS.update(before)
