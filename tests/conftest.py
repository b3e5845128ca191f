"""What all tests share: compiled programs kept between sessions, long runs on demand, test data."""

import os
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import pytest
from hypothesis import settings

# Read when jax is imported, which test modules do after this.
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "identifiability"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")

# As many tests run side by side as there are cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"

# Compilation makes single examples slow; the same examples every time make a failure repeatable.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=500)
settings.load_profile("repeatable")


def pytest_configure(config):
    """Do before the workers begin what two of them should not do at once."""
    if hasattr(config, "workerinput"):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz  # noqa: F401 (0.x, imported by two at once, fails once a day)
    if config.option.numprocesses and not config.option.collectonly:
        _compile_loops()


def _compile_loops():
    """Compile in two processes what each worker would compile as a whole, unless it is there."""
    from identifiability.loops import folder

    if any(folder().rglob("*.nbi")):
        return
    script = Path(__file__).with_name("first_compiled.py")
    parts = [subprocess.Popen([sys.executable, script, part]) for part in ("responses", "noises")]
    for part in parts:
        assert part.wait() == 0, "a loop cannot be compiled; see above"


def pytest_collection_modifyitems(config, items):
    """Skip tests that take minutes unless they are asked for."""
    for apart in ("long", "recordings", "notebooks"):
        if apart in config.getoption("markexpr"):
            continue
        skip = pytest.mark.skip(reason=f"takes minutes; run it with -m {apart}")
        for item in items:
            if item.get_closest_marker(apart):
                item.add_marker(skip)


_FAILED = []  # parts of investigations, in the order in which they failed


def pytest_collection_finish():
    """Take note of the parts that fail in any investigation, whoever makes it."""
    from identifiability.investigation.findings import Findings

    made = Findings.__init__

    def noted(findings, *args, **fields):
        made(findings, *args, **fields)
        _FAILED.extend(findings.failed)

    Findings.__init__ = noted


@pytest.fixture(autouse=True)
def nothing_fails_unseen(request):
    """A part of an investigation that fails, fails the test too, unless that is what it is about.

    Those of a module's fixtures count for the first test that uses them.
    """
    yield
    failed, _FAILED[:] = tuple(_FAILED), ()
    assert not failed or request.node.get_closest_marker("parts_fail"), failed


@pytest.fixture
def few_effects(monkeypatch):
    """Commands that try few effects: all of them compete in the benchmark's cases."""
    from identifiability.investigation.investigate import investigate
    from identifiability.joint.effects import EFFECTS

    # A Maxwell branch would be of the tendon's form.
    keys = ("cubic_stiffness", "series_tendon")
    few = partial(investigate, library={key: EFFECTS[key] for key in keys})
    monkeypatch.setattr("identifiability.investigation.investigate.investigate", few)


@pytest.fixture
def no_smallest_effects(monkeypatch):
    """Investigations that do not look for the smallest effects seen, which takes most of a null."""
    from identifiability.investigation.session import Investigation

    monkeypatch.setattr(Investigation, "smallest_seen", lambda *args, **options: ())


@pytest.fixture
def shown_alone(monkeypatch):
    """Reports whose figures are drawn for the page alone, and not in all formats beside it."""
    monkeypatch.setattr("identifiability.plots.style.PRINTED_AS", (".svg",))


@pytest.fixture(scope="session")
def shared_data():
    """Folder of the recordings that are not part of this repository."""
    if not SHARED.is_dir():
        pytest.skip(f"needs {SHARED}")
    return SHARED
