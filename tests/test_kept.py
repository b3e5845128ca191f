"""Fits kept on disk: read again bit for bit, for the same question only."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hidden import HELD, JOINT, trials

from identifiability.errors import InputError
from identifiability.inference import fitting
from identifiability.investigation.fits import bench as workbench
from identifiability.investigation.fits import kept
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.kept import InMemory, OnDisk
from identifiability.investigation.investigate import investigate
from identifiability.investigation.posterior.evidence import Evaluator
from identifiability.investigation.record import investigation_record
from identifiability.investigation.session import Investigation
from identifiability.investigation.split import gather
from identifiability.joint.effects import CubicStiffness, SeriesTendon
from identifiability.joint.model import KBI

MODEL = KBI() + SeriesTendon()
VALUES = JOINT | {"series_tendon.stiffness": 60.0}


@pytest.fixture(scope="module")
def split():
    return gather(trials(MODEL, VALUES), trials(MODEL, VALUES, seed=9, conditions=HELD))


@pytest.fixture
def fits(monkeypatch):
    """Models that were fitted, not read."""
    done = []

    def counted(problem, *args, **options):
        done.append(problem.model.effect_keys)
        return fitting.explore(problem, *args, **options)

    monkeypatch.setattr(workbench, "explore", counted)
    return done


def assert_same(one, two):
    for part in ("fitted", "held_out"):
        a, b = getattr(one, part), getattr(two, part)
        assert [x.tobytes() for x in a.by_trial] == [x.tobytes() for x in b.by_trial]
        assert (a.errors.tobytes(), a.weighted) == (b.errors.tobytes(), b.weighted)
    plain = [
        {k: v for k, v in vars(c).items() if k not in ("fitted", "held_out", "seconds")}
        for c in (one, two)
    ]
    assert plain[0] == plain[1]


@pytest.mark.parametrize("held", [True, False])
def test_a_kept_fit_is_read_as_it_was(tmp_path, split, fits, held):
    split = split if held else replace(split, held_out=())
    plain = Workbench(split).fit(MODEL, [VALUES])
    first = Workbench(split, kept=OnDisk(tmp_path)).fit(MODEL, [VALUES])
    assert len(fits) == 2
    again = Workbench(split, kept=OnDisk(tmp_path)).fit(MODEL, [VALUES])
    assert len(fits) == 2
    assert_same(plain, first)
    assert_same(plain, again)


def test_another_question_is_another_fit(tmp_path, split, fits):
    def ask(trials_=split, bounds=None, model=MODEL, start=VALUES, **options):
        bench = Workbench(trials_, bounds or {}, OnDisk(tmp_path))
        return bench.fit(model, [start], **options)

    ask()
    ask(bounds={"K": (1.0, 40.0)})
    ask(start=VALUES | {"K": 31.0})
    ask(refined=("series_tendon",))
    ask(model=KBI(), start=JOINT)
    ask(trials_=replace(split, held_out=split.held_out[:1]))
    ask(trials_=split.without_leads())
    assert len(fits) == len(list(tmp_path.iterdir())) == 7


def test_a_fit_of_other_code_is_not_read(tmp_path, split, fits, monkeypatch):
    first = Workbench(split, kept=OnDisk(tmp_path)).fit(KBI(), [JOINT])
    with monkeypatch.context() as patched:
        patched.setattr(kept, "code_fingerprint", lambda module: "0" * 32)
        assert OnDisk(tmp_path).files == []
        Workbench(split, kept=OnDisk(tmp_path)).fit(KBI(), [JOINT])
        assert len(fits) == 2
    assert_same(first, Workbench(split, kept=OnDisk(tmp_path)).fit(KBI(), [JOINT]))
    assert len(fits) == 2
    assert len(OnDisk(tmp_path).files) == 1


class Earlier(CubicStiffness):
    """An effect of one's own."""

    key = "own"

    def torque(self, p, motion, states, delayed):
        return p[0] * motion.angle**3


class Later(Earlier):
    """The same, its equation edited."""

    def torque(self, p, motion, states, delayed):
        return p[0] * motion.angle**5


Earlier.__name__ = Later.__name__ = "Own"


def test_an_effect_of_ones_own_with_another_equation_is_another_fit(tmp_path, split, fits):
    def ask(effect):
        Workbench(split, kept=OnDisk(tmp_path)).fit(
            KBI() + effect(), [JOINT | {"own.coefficient": 1.0, "own.centre": 0.0}]
        )

    ask(Earlier)
    ask(Earlier)
    assert len(fits) == 1
    ask(Later)
    assert len(fits) == 2


def test_a_damaged_file_is_written_anew(tmp_path, split, fits):
    bench = Workbench(split, kept=OnDisk(tmp_path))
    first = bench.fit(KBI(), [JOINT])
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert_same(first, bench.fit(KBI(), [JOINT]))
    assert len(fits) == 2
    assert_same(first, bench.fit(KBI(), [JOINT]))
    assert len(fits) == 2


def test_a_fit_that_failed_is_tried_again(tmp_path, split, monkeypatch):
    def fails(*args, **options):
        raise InputError("no luck")

    bench = Workbench(split, kept=OnDisk(tmp_path))
    with monkeypatch.context() as patched:
        patched.setattr(workbench, "explore", fails)
        assert bench.fit(KBI(), [JOINT]).failure == "no luck"
    assert not list(tmp_path.iterdir())
    assert not bench.fit(KBI(), [JOINT]).failure


def test_a_weighing_that_was_stopped_goes_on(tmp_path, monkeypatch):
    library = {"series_tendon": SeriesTendon}
    hidden = trials(MODEL, VALUES), trials(MODEL, VALUES, seed=9, conditions=HELD)
    evaluated, evaluate = [], Evaluator.evaluate

    def counted(self, model, *args, **options):
        evaluated.append(model)
        return evaluate(self, model, *args, **options)

    monkeypatch.setattr(Evaluator, "evaluate", counted)

    def weigh(kept, **options):
        del evaluated[:]
        return Investigation(*hidden, library=library, kept=kept, **options).weigh()

    whole, n_whole = weigh(InMemory()), len(evaluated)

    def stop(what, done, total):
        if "something unknown" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        weigh(OnDisk(tmp_path), progress=stop)
    assert len(evaluated) == n_whole
    resumed = weigh(OnDisk(tmp_path))
    assert not evaluated
    # Not nearly: bit by bit.
    assert [(r.effects, r.probability, r.log_evidence) for r in resumed.rows] == [
        (r.effects, r.probability, r.log_evidence) for r in whole.rows
    ]
    # What was kept of other trials is not taken.
    hidden = hidden[::-1]

    def stop(what, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        weigh(OnDisk(tmp_path), progress=stop)
    assert evaluated


@pytest.mark.long
def test_an_investigation_that_was_stopped_goes_on(tmp_path, fits):
    """And the same seed gives the same record: what is read was found a second time."""
    library = {"series_tendon": SeriesTendon}
    hidden = trials(MODEL, VALUES), trials(MODEL, VALUES, seed=9, conditions=HELD)

    def study(**options):
        return investigate(*hidden, library=library, with_widths=False, seed=5, **options)

    whole = study()
    n_whole = len(fits)

    def stop(what, done, total):
        if "what is left" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study(kept=OnDisk(tmp_path), progress=stop)
    n_stopped = len(fits) - n_whole
    n_kept = len(OnDisk(tmp_path).files)
    assert 2 <= n_kept == n_stopped == n_whole
    resumed = study(kept=OnDisk(tmp_path))
    assert len(fits) == n_whole + n_stopped
    records = [investigation_record(found, command="") for found in (whole, resumed)]
    for record in records:
        assert min(record.pop("timings").values()) >= 0
    assert json.dumps(records[0]) == json.dumps(records[1])
    assert np.isfinite(records[0]["baseline"]["error_fit"])
