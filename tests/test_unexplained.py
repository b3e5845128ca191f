"""What is left, by kind: noise, sensor, drift, static, memory, unrepeatable."""

from dataclasses import replace

import numpy as np
import pytest

from identifiability.benchmark.cases import hidden_cases
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.rules import Rules
from identifiability.investigation.split import gather
from identifiability.investigation.unexplained.account import Unexplained, unexplained
from identifiability.investigation.unexplained.explanation import Family
from identifiability.investigation.unexplained.readouts import DelayReadout
from identifiability.investigation.wording.describe import describe
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial

TIME = np.arange(500) / 1000
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
DRIVES = [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6), ("pulse", 12), ("step", 2)]


def left_of(model, values, seed=1, noise=3e-3, vary=0.0, drift=0.0):
    """What K, B and I leave of trials of a model."""
    rng = np.random.default_rng(seed)
    trials = []
    for i, (kind, size) in enumerate(DRIVES):
        torque = size * ((TIME > 0.05) & ((TIME <= 0.1) | (kind == "step")))
        theta = model.vector(values | {"K": values["K"] * (1 + vary * (-1) ** (i // 2))})
        angle = simulate(model, theta, SampledTorque(torque).drive(TIME))
        size_of = np.sqrt(np.mean(angle**2))
        angle = angle + noise * size_of * rng.standard_normal(TIME.size)
        angle = angle + drift * size_of * rng.standard_normal() * TIME**2
        trials.append(Trial(TIME, torque, angle, name=f"t{i}", condition=kind))
    bench = Workbench(gather(trials, trials[:1]))
    found = bench.fit(KBI(), [JOINT])
    return unexplained(bench, found)


@pytest.mark.parametrize("seed", range(6))
def test_noise_is_noise(seed):
    rest = left_of(KBI(), JOINT, seed)
    assert rest.best.kind == "none"
    assert rest.noise_ratio == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize(
    ("effect", "values", "kind"),
    [
        ("cubic_stiffness", {"coefficient": 250.0}, "static"),
        ("maxwell_branch", {"stiffness": 25.0, "time_constant": 0.05}, "memory"),
        ("sensor_delay", {"delay": 0.006}, "sensor"),
    ],
)
def test_each_kind_is_recognised(effect, values, kind):
    model = KBI() + EFFECTS[effect]()
    known = {f"{effect}.{name}": value for name, value in values.items()}
    whole = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT | known
    rest = left_of(model, whole)
    assert rest.best.kind == kind
    assert rest.decided
    assert rest.decisive == Rules().decisive_kind
    assert rest.share > 0.9
    assert all(np.all(np.isfinite(t.mean)) and np.all(t.sd >= 0) for t in rest.torque)


def test_stiffness_that_differs_from_trial_to_trial_is_unrepeatable():
    rest = left_of(KBI(), JOINT, vary=0.08)
    assert rest.best.kind == "unrepeatable"
    assert rest.decided


def test_a_drift_is_a_drift():
    assert left_of(KBI(), JOINT, drift=0.5).best.kind == "drift"


def test_the_missing_torque_is_the_one_that_is_missing():
    """Cubic stiffness of an independent simulator: the torque by angle, but for a linear part."""
    case = next(s for s in hidden_cases("singles", 3) if s.keys == ("cubic_stiffness",)).build()
    bench = Workbench(gather(case.fit, case.held_out))
    found = bench.fit(KBI(), [JOINT])
    rest = unexplained(bench, found)
    assert rest.best.kind == "static"
    angles = np.concatenate([r.compared for r in bench.split.fitted])
    torque = np.concatenate([t.mean for t in rest.torque])
    strong = np.abs(angles) > 0.5 * np.abs(angles).max()
    shape = np.column_stack([angles, angles**3])[strong]
    linear, cubic = np.linalg.lstsq(shape, torque[strong], rcond=None)[0]
    assert linear * cubic < 0
    assert np.corrcoef(shape @ [linear, cubic], torque[strong])[0, 1] > 0.9


# What was found is data, judged by rules, and words are made of it


def account(kind="memory", *, margin=20.0, delay=0.04, nats=50.0, noise_ratio=1.0, **rules):
    families = tuple(
        Family(k, k, k, evidence, {}, {k: 1.0}, False)
        for k, evidence in ((kind, 0.0), ("static", -margin))
    )
    readout = DelayReadout(delay, 0.001, 0.02, 0.001, nats)
    return Unexplained(families, margin, 0.9, (), noise_ratio, None, readout, rules=Rules(**rules))


def test_a_kind_is_decided_by_the_rules_margin():
    assert account(margin=5.0).decided
    assert not account(margin=4.9).decided
    assert not account(margin=5.0, decisive_kind=6.0).decided


@pytest.mark.parametrize(
    ("decay", "said"),
    [(0.0, "within a few milliseconds"), (0.03, "with a time constant of about 30 ms")],
)
def test_what_fades_quicker_than_can_be_told_has_no_time_constant(decay, said):
    readout = DelayReadout(0.0, 0.001, decay, 0.001, 0.0)
    rest = replace(account(), delay_readout=readout)
    assert f"and fades {said}" in unexplained_sentence(rest)


def test_a_latency_is_spoken_of_where_it_is_clear_and_long_enough():
    assert account().latency == 0.04
    assert account(nats=6.9).latency is None  # 5, and a tenth of the margin of 20
    assert account(delay=0.009).latency is None
    assert account("hysteresis").latency is None
    assert account(delay=0.009, least_latency=0.005).latency == 0.009


def test_noise_that_is_larger_than_before_the_perturbation_does_not_suffice():
    assert account("none", noise_ratio=1.5).noise_suffices
    assert account("none", noise_ratio=None).noise_suffices
    assert not account("none", noise_ratio=1.6).noise_suffices
    assert account("none", noise_ratio=1.6, enough_noise=2.0).noise_suffices


def test_what_differs_is_worded_differently():
    accounts = [
        *(account(kind) for kind in ("none", "drift", "sensor", "hysteresis", "unrepeatable")),
        account(),
        account(nats=0.0),
        account(margin=1.0),
        account("none", noise_ratio=3.0),
    ]
    said = [describe(rest) for rest in accounts]
    assert all(len(sentences) == 1 for sentences in said)
    assert len(set(said)) == len(accounts)
