"""Fingerprints tell computations apart, whatever process or machine they are made on."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from identifiability.errors import InputError
from identifiability.provenance import (
    PACKAGE,
    code_fingerprint,
    fingerprint,
    made_by,
    read_record,
    remark,
    stamp,
)


@dataclass(frozen=True)
class Setting:
    number: int
    note: str = ""


def test_fingerprints_tell_configurations_apart():
    values = [
        Setting(1),
        Setting(2),
        Setting(1, note="x"),
        {"a": 1, "b": 2.0},
        {"a": 1, "b": 2.0000000001},
        [1, 2],
        [2, 1],
        np.arange(3.0),
        np.arange(3.0)[::-1],
        np.arange(3),
        None,
    ]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint(np.float64(0.1)) == fingerprint(0.1)
    # Written down, because results on disk are found by it.
    assert fingerprint("a", 1, 0.1) == "84c79b69ebcae7df28e2d0c577dd8270"


def test_what_has_no_fingerprint_is_refused():
    with pytest.raises(TypeError, match="plain values"):
        fingerprint(object())


# The code

STUDY = "identifiability.study.atlas"
FITS = "identifiability.investigation.fits.bench"


@pytest.fixture
def copied(tmp_path):
    """A copy of the package's sources, whose fingerprint is never one that is remembered."""
    package = tmp_path / PACKAGE.name
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    return package


def of(package: Path, *modules: str) -> str:
    return code_fingerprint.__wrapped__(*modules, package=package)


def test_the_same_sources_have_the_same_fingerprint_wherever_they_lie(copied):
    for modules in ((), (STUDY,), (FITS,)):
        assert of(copied, *modules) == of(copied, *modules) == of(PACKAGE, *modules)
        assert of(copied, *modules) == code_fingerprint(*modules)
    assert len({of(copied), of(copied, STUDY), of(copied, FITS), of(copied, STUDY, FITS)}) == 4


@pytest.mark.parametrize(
    ("path", "study", "fits"),
    [
        ("joint/integrator.py", True, True),
        ("joint/__init__.py", True, True),
        ("joint/effects/gravity.py", True, True),
        ("inference/fitting.py", True, True),
        ("investigation/fits/bench.py", False, True),
        ("study/atlas.py", True, False),
        ("cli/main.py", False, False),
        ("plots/atlas.py", False, False),
        ("report/page.py", False, False),
    ],
)
def test_a_byte_changes_the_fingerprint_of_what_it_takes_part_in(copied, path, study, fits):
    before = [of(copied, *modules) for modules in ((), (STUDY,), (FITS,))]
    with (copied / path).open("ab") as file:
        file.write(b"#")
    after = [of(copied, *modules) for modules in ((), (STUDY,), (FITS,))]
    assert [a != b for a, b in zip(after, before, strict=True)] == [True, study, fits]


def test_a_file_that_is_renamed_or_added_changes_it(copied):
    before = of(copied)
    (copied / "joint" / "more.py").write_text("")
    added = of(copied)
    (copied / "joint" / "more.py").rename(copied / "joint" / "other.py")
    assert len({before, added, of(copied)}) == 3


def test_imports_of_every_form_are_followed(tmp_path):
    package = tmp_path / "house"
    (package / "rooms").mkdir(parents=True)
    sources = {
        "__init__": "",
        "a": "import house.b\n",
        "b": "def f():\n    from house.rooms import (  # here\n        c,\n    )\n",
        "rooms/__init__": "from house.d import g\n",
        "rooms/c": "import numpy, house.e as e\n",
        **dict.fromkeys(("d", "e", "f"), ""),
        "all": "from house import something\n",
    }
    for name, source in sources.items():
        (package / f"{name}.py").write_text(source)
    parts = {"a", "b", "rooms/__init__", "rooms/c", "d", "e"}
    for name in sources:
        before = of(package, "house.a"), of(package, "house.all")
        with (package / f"{name}.py").open("a") as file:
            file.write("#")
        assert (of(package, "house.a") != before[0]) is (name in parts), name
        # Whoever imports a name of the root may be using anything.
        assert of(package, "house.all") != before[1]


def test_a_module_of_ones_own_counts_with_what_it_imports():
    assert code_fingerprint(__name__) not in (code_fingerprint(), code_fingerprint(STUDY))
    with pytest.raises(InputError, match="no source of the module 'nowhere'"):
        code_fingerprint("nowhere")


# Records


def test_a_record_of_this_code_is_read_without_a_remark(tmp_path):
    path = tmp_path / "record.json"
    path.write_text(json.dumps({"schema": 1, **stamp(STUDY)}))
    stored = read_record(path)
    assert stored.record["schema"] == 1
    assert stored.remark == ""
    assert code_fingerprint(STUDY)[:12] in made_by(stored.record)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"code": "0" * 32}, "fingerprint 000000000000"),
        ({"code_of": FITS}, "fingerprint"),
        ({"code_of": "identifiability.gone"}, "gone"),
        ({"code": ""}, "no fingerprint"),
    ],
)
def test_a_record_of_other_code_says_so(tmp_path, change, words):
    path = tmp_path / "record.json"
    path.write_text(json.dumps({**stamp(STUDY), **change}))
    assert words in read_record(path).remark
    assert read_record(path).remark == remark({**stamp(STUDY), **change})


@pytest.mark.parametrize(
    ("content", "words"), [(None, "cannot read"), ("{", "not valid JSON"), ("[1]", "no record")]
)
def test_what_is_no_record_is_told_in_one_sentence(tmp_path, content, words):
    path = tmp_path / "record.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=words):
        read_record(path)
