"""Notebooks run, and what is stored in them is what they say."""

import re
from pathlib import Path

import nbclient
import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
ANKLE = "05_a_real_ankle"
SHIPPED = sorted(path.stem for path in FOLDER.glob("*.ipynb") if path.stem != ANKLE)


def said(book):
    """By cell, the text of its outputs without its numbers, and how many pictures there are."""
    for cell in book.cells:
        if cell.cell_type == "code":
            shown = [o.get("data", {}) for o in cell.outputs]
            lines = [o.text for o in cell.outputs if o.get("name") == "stdout"]
            lines += [d["text/plain"] for d in shown if "text/plain" in d and "image/png" not in d]
            text = re.sub(r"[-+]?\d+(\.\d*)?(e[-+]?\d+)?", "#", "".join(lines))
            yield " ".join(text.split()), sum("image/png" in d for d in shown)


def run(stem, timeout):
    """A notebook as it is stored, and as it comes out."""
    stored = nbformat.read(FOLDER / f"{stem}.ipynb", as_version=4)
    found = nbformat.from_dict(stored)
    resources = {"metadata": {"path": FOLDER}}
    nbclient.NotebookClient(found, timeout=timeout, resources=resources).execute()
    return stored, found


@pytest.mark.notebooks
@pytest.mark.parametrize("stem", SHIPPED)
def test_it_says_what_is_stored(stem):
    stored, found = run(stem, 600)
    assert list(said(found)) == list(said(stored))


@pytest.mark.notebooks
def test_without_the_recording_of_an_ankle_it_says_so(monkeypatch):
    monkeypatch.delenv("IDENTIFIABILITY_ANKLE", raising=False)
    with pytest.raises(CellExecutionError, match="set IDENTIFIABILITY_ANKLE to") as stopped:
        run(ANKLE, 60)
    assert stopped.value.ename == "SystemExit"


@pytest.mark.long
@pytest.mark.recordings
def test_the_ankle_says_what_is_stored(shared_data, monkeypatch):
    monkeypatch.setenv("IDENTIFIABILITY_ANKLE", str(shared_data / "real" / "reklab_ankle_z.mat"))
    stored, found = run(ANKLE, 2 * 3600)
    assert list(said(found)) == list(said(stored))
