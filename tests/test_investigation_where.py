"""Where a model fails, and whether K, B and I are constant: on joints whose effects are known."""

import json
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy import stats

from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import NOTHING
from identifiability.investigation.fits.refits import Refits, without_levels
from identifiability.investigation.rules import Rules
from identifiability.investigation.split import gather
from identifiability.investigation.where.compare import compare
from identifiability.investigation.where.imposed import imposed, starts
from identifiability.investigation.where.in_time import TimeView
from identifiability.investigation.where.locate import locate
from identifiability.investigation.where.record import comparison_record, location_record
from identifiability.investigation.where.view import Panel, View
from identifiability.investigation.where.views import VIEWS
from identifiability.investigation.where.whitening import Portion, excess, whitening
from identifiability.investigation.wording.describe import describe
from identifiability.joint.effects import EFFECTS
from identifiability.joint.effects.coulomb_friction import CoulombFriction
from identifiability.joint.effects.cubic_stiffness import CubicStiffness
from identifiability.joint.effects.quadratic_stiffness import QuadraticStiffness
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.effects.stretch_reflex import StretchReflex
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise, correlation_time
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial
from identifiability.plots.investigation_where import (
    comparison_figure,
    responses_figure,
    where_figure,
)
from identifiability.plots.style import COLUMN

LEAD, N = 50, 400
TIME = np.arange(N) * 1e-3
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
NOISE = 0.005  # of the response's r.m.s.: an error E of 2.5e-5
LOADS = (
    ("pulse", 10.0),
    ("pulse", -10.0),
    ("pulse", 5.0),
    ("pulse", -5.0),
    ("step", 2.0),
    ("step", -2.0),
)


def torque_of(kind, amplitude):
    torque = np.zeros(N)
    torque[LEAD : LEAD + 20 if kind == "pulse" else N] = amplitude
    return torque


@cache
def responses(model, values=(), loads=LOADS):
    theta = model.vector(JOINT | dict(values))
    out = []
    for kind, amplitude in loads:
        drive = SampledTorque(torque_of(kind, amplitude)).drive(TIME)
        out.append(simulate(model, theta, drive))
    return out


def recorded(model, values=(), *, seed=1, correlation=0.0, first=0, level=0.0, loads=LOADS):
    """Trials with noise; from the sample `first` on."""
    seeds = np.random.SeedSequence(seed).spawn(len(loads))
    trials = []
    for i, (load, angle) in enumerate(zip(loads, responses(model, values, loads), strict=True)):
        noise = Noise(NOISE * float(np.sqrt(np.mean(angle**2))), correlation)
        angle = angle + noise.draw(N, 1e-3, seeds[i]) + level
        trials.append(Trial(TIME[first:], torque_of(*load)[first:], angle[first:], name=f"t{i}"))
    return trials


def fitted(trials):
    bench = Workbench(gather(trials, trials[:1]))
    candidate = bench.fit(KBI(), [JOINT])
    assert not candidate.failure
    return bench, candidate


@cache
def findings(model, values=()):
    bench, candidate = fitted(recorded(model, values))
    return compare(bench, candidate), locate(bench, candidate)


TENDON = KBI() + SeriesTendon(), (("B", 3.0), ("series_tendon.stiffness", 100.0))
CUBIC = (
    KBI() + CubicStiffness(),
    (("K", 20.0), ("cubic_stiffness.coefficient", 800.0), ("cubic_stiffness.centre", 0.0)),
)
FAST_REFLEX = (
    ("stretch_reflex.position_gain", 20.0),
    ("stretch_reflex.velocity_gain", 2.0),
    ("stretch_reflex.delay", 0.06),
    ("stretch_reflex.time_constant", 0.004),
    ("stretch_reflex.asymmetry", 0.0),
    ("stretch_reflex.threshold", 0.0),
    ("stretch_reflex.off_ratio", 1.0),
    ("stretch_reflex.damping_ratio", 1.0),
)


def risen(constancy, parameter):
    """Whether a change of a parameter is one that is named, and upward."""
    change = next(c for c in constancy.changes if c.parameter == parameter)
    return change.notable and change.after > change.before


def upper_bound(n, rate=0.05):
    """Most false alarms that chance allows, but for one run in a thousand."""
    return stats.binom.ppf(0.999, n, rate)


# Nothing is missing


RUNS = [8, pytest.param(32, marks=pytest.mark.long)]


@pytest.mark.parametrize("runs", RUNS)
@pytest.mark.parametrize(("correlation", "level"), [(0.0, 0.0), (0.005, 0.02)])
def test_a_joint_that_is_K_B_and_I_raises_few_alarms(correlation, level, runs):
    alarms = dict.fromkeys(["time", "frequency", "state", "direction", "amplitude", "trials"], 0)
    aspects = dict.fromkeys(["window", "amplitude", "direction", "condition", "trial"], 0)
    for seed in range(runs):
        trials = recorded(KBI(), seed=seed, correlation=correlation, level=level)
        bench, candidate = fitted(trials)
        location, comparison = locate(bench, candidate), compare(bench, candidate)
        assert location.noise_known
        time = location.views["time"]
        assert time.latency is None or time.significant
        for name in alarms:
            alarms[name] += location.views[name].significant
        for name in aspects:
            aspects[name] += comparison.by(name).p_value < 0.05
    assert max(alarms.values()) <= upper_bound(runs), alarms
    assert max(aspects.values()) <= upper_bound(runs), aspects
    # Pooled, the alarms must not be frequent either; views of one run are not independent.
    assert sum(alarms.values()) <= upper_bound(runs) * len(alarms) / 2


@pytest.mark.parametrize("n_trials", [1, 8])
@pytest.mark.parametrize("n_lead", [20, 50])
def test_sums_of_squares_over_estimated_noise_have_honest_probabilities(n_trials, n_lead):
    rng = np.random.default_rng(3)
    runs, blocks = 4000, 4
    levels = np.sqrt(np.mean(rng.standard_normal((runs, n_trials, n_lead)) ** 2, axis=2))
    z = rng.standard_normal((runs, n_trials, blocks)) / levels[:, :, None]
    portions = [Portion(blocks, 0.0, float(n_lead))] * n_trials
    found = np.array([excess(float(total), portions) for total in np.sum(z**2, axis=(1, 2))])
    assert np.mean(found[:, 0]) == pytest.approx(1.0, abs=0.05)
    for level in (0.05, 0.005):
        chance = 4 * np.sqrt(level * (1 - level) / runs)
        assert np.mean(found[:, 1] < level) == pytest.approx(level, abs=chance)


def test_an_uncertain_level_or_spectrum_makes_large_sums_likelier():
    plain = excess(20.0, [Portion(8, 0.0, 50.0)])[1]
    assert excess(20.0, [Portion(8, 4.0, 50.0)])[1] > plain
    assert excess(20.0, [Portion(8, 0.0, 50.0)], 0.2)[1] > plain
    assert excess(0.0, []) == (1.0, 1.0)


@pytest.mark.parametrize("level", [0.0, 0.05])
def test_coloured_noise_is_whitened(level):
    trials = [
        t for seed in range(4) for t in recorded(KBI(), seed=seed, correlation=0.01, level=level)
    ]
    split = gather(trials)
    noise = whitening(split.fitted, NOTHING)
    assert noise.known
    truth = np.exp(-0.1)
    assert noise.coefficients.sum() == pytest.approx(truth, abs=4 * np.sqrt((1 - truth**2) / 800))
    ready = split.fitted[0]
    white = noise.white(0, ready.response[:LEAD, None])
    assert np.std(white[noise.coefficients.size :]) == pytest.approx(1.0, abs=0.1)
    # What is known from few samples only is said to be uncertain, most so at low frequencies.
    assert noise.slack(np.zeros(1)) > noise.block_slack(5) > 0


def test_correlation_times_of_pieces_are_pooled():
    rng = np.random.default_rng(5)
    assert correlation_time(*rng.standard_normal((20, 50))) == pytest.approx(1.0, abs=0.2)
    rho = 0.8
    pieces = [Noise(1.0, -1 / np.log(rho)).draw(200, 1.0, seed) for seed in range(20)]
    expected = (1 + rho) / (1 - rho)
    assert correlation_time(*pieces) == pytest.approx(expected, rel=0.25)
    assert correlation_time(np.zeros(9)) == 1.0


def test_levels_are_taken_out_as_far_as_they_are_unknown():
    rng = np.random.default_rng(7)
    rows, group = rng.standard_normal((12, 2)), np.repeat([0, 1], 6)
    freed = without_levels(rows, np.full(12, 1e6), group)
    expected = rows - np.repeat([rows[:6].mean(axis=0), rows[6:].mean(axis=0)], 6, axis=0)
    assert freed == pytest.approx(expected, abs=1e-5)
    level = rng.standard_normal(6)
    whiten = without_levels(np.eye(6), level, np.zeros(6, int))
    assert whiten @ (np.eye(6) + np.outer(level, level)) @ whiten.T == pytest.approx(np.eye(6))
    assert without_levels(rows, np.zeros(12), group) is rows


# What was imposed


def test_scaled_copies_are_of_one_kind():
    split = gather(recorded(KBI()), [])
    trials = sorted((*split.fitted, *split.held_out), key=lambda ready: ready.name)
    found = imposed(trials)
    assert [f.kind for f in found] == [0, 0, 0, 0, 1, 1]
    assert [f.gain for f in found] == pytest.approx([1, -1, 0.5, -0.5, 1, -1])
    assert [f.direction for f in found] == [1, -1, 1, -1, 1, -1]
    assert [f.amplitude for f in found] == pytest.approx([10, 10, 5, 5, 2, 2])
    assert {f.condition for f in found} == {"like t0", "like t4"}
    assert [starts(ready).tolist() for ready in trials] == [[LEAD - 1]] * 6 or [
        starts(ready).tolist() for ready in trials
    ] == [[LEAD]] * 6


def test_conditions_that_are_named_are_kept():
    trials = [
        Trial(t.time, t.torque, t.angle, name=t.name, condition=c)
        for t, c in zip(recorded(KBI()), "aabbcc", strict=True)
    ]
    assert [f.condition for f in imposed(gather(trials, trials[:1]).fitted)] == list("aabbcc")


# Missing effects


def test_a_cubic_spring_is_odd_and_does_not_scale():
    comparison, location = findings(*CUBIC)
    direction, state = location.views["direction"], location.views["state"]
    assert direction.odd_significant
    assert not direction.even_significant
    assert direction.p_odd < 1e-6
    assert location.views["amplitude"].significant
    assert all(gain > 0 for gain in location.views["amplitude"].gains)
    assert state.significant
    assert state.angle.share > max(0.6, state.velocity.share)
    size = comparison.by("amplitude")
    assert size.significant
    small, large = (group.values[0] for group in size.groups)
    assert 20 < small < large
    assert risen(size, "K")
    assert not comparison.by("direction").significant


def test_a_one_sided_spring_is_even():
    own = (("coefficient", 60.0), ("hardening", 0.0))
    values = (("K", 30.0), *((f"quadratic_stiffness.{name}", value) for name, value in own))
    comparison, location = findings(KBI() + QuadraticStiffness(), values)
    direction = location.views["direction"]
    assert direction.even_significant
    assert direction.p_even < direction.p_odd
    positive, negative = (g.values[0] for g in comparison.by("direction").groups)
    assert positive > negative
    assert comparison.by("direction").significant


def test_friction_depends_on_the_velocity():
    values = tuple(
        (name, {"coulomb_friction.torque": 0.3}.get(name, p.nominal))
        for name, p in (KBI() + CoulombFriction()).parameters.items()
        if name not in JOINT
    )
    _, location = findings(KBI() + CoulombFriction(), values)
    state = location.views["state"]
    assert state.significant
    assert state.velocity.share > state.angle.share
    assert location.views["amplitude"].significant


def test_a_reflex_shows_after_its_delay_and_is_linear():
    comparison, location = findings(KBI() + StretchReflex(), FAST_REFLEX)
    assert 0.055 <= location.views["time"].latency <= 0.1
    assert not location.views["amplitude"].significant
    assert location.views["amplitude"].misfit
    assert not location.views["direction"].even_significant
    assert location.views["direction"].odd_significant
    window = comparison.by("window")
    assert window.significant
    # Within the delay the joint is what the model says it is.
    short = window.groups[0]
    assert np.all(np.abs(short.values - list(JOINT.values())) < 4 * short.errors)


def test_a_tendon_changes_K_with_the_window_alone():
    comparison, location = findings(*TENDON)
    window = comparison.by("window")
    assert window.significant
    assert [group.label for group in window.groups] == ["50 ms", "100 ms", "200 ms"]
    stiffness = [group.values[0] for group in window.groups]
    assert stiffness[0] > stiffness[1] > stiffness[2]
    assert risen(window, "K")
    assert (window.changes[0].first, window.changes[0].second) == ("200 ms", "50 ms")
    assert not comparison.by("amplitude").significant
    assert not comparison.by("direction").significant
    views = location.views
    assert views["time"].significant
    assert views["frequency"].significant
    assert views["frequency"].coherent.any()
    assert views["direction"].odd_significant
    assert not views["direction"].even_significant
    assert not views["amplitude"].significant
    assert views["trials"].significant
    assert views["trials"].flags.all()


def test_with_the_tendon_in_the_model_nothing_changes_any_more():
    bench, plain = fitted(recorded(*TENDON))
    model = TENDON[0]
    candidate = bench.fit(model, starting_values(model, plain.values))
    assert candidate.fitted.error == pytest.approx(bench.split.noise_floor(), rel=0.2)
    assert not compare(bench, candidate).by("window").significant
    location = locate(bench, candidate)
    assert not location.views["time"].significant
    assert not location.views["direction"].significant
    assert location.views["time"].latency is None


# Tables


def test_the_table_of_trials_agrees_with_the_fit():
    bench, candidate = fitted(recorded(*CUBIC))
    comparison = compare(bench, candidate)
    assert comparison.error == pytest.approx(np.mean([row.error for row in comparison.trials]))
    for row, ready, left in zip(
        comparison.trials, bench.split.fitted, candidate.fitted.by_trial, strict=True
    ):
        assert row.name == ready.name
        assert row.error == pytest.approx(np.sum(left**2) / np.sum(ready.response**2))
        assert row.vaf == pytest.approx(100 * (1 - np.var(left) / np.var(ready.response)))
        assert row.noise_ratio == pytest.approx(row.rms / ready.lead.sd)
        assert row.n_samples == N
    trial = comparison.by("trial")
    assert [group.label for group in trial.groups] == [f"t{i}" for i in range(6)]
    assert trial.groups[0].n_samples == N


def test_a_refit_to_everything_is_the_fit_itself():
    bench, candidate = fitted(recorded(*CUBIC))
    refits = Refits(bench, candidate)
    sds = bench.split.weights_sd(bench.split.fitted)
    found = refits.fit(lambda i, columns: columns / sds[i], refits.values * [1.3, 0.7, 1.1])
    assert found.values == pytest.approx(refits.values, rel=1e-3)
    assert found.cost == pytest.approx(candidate.fitted.weighted, rel=1e-6)
    left, _ = refits.linearised(refits.values)
    for mine, theirs in zip(left, candidate.fitted.by_trial, strict=True):
        assert mine[:, 0] == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("runs", RUNS)
def test_standard_errors_are_those_of_repeated_measurements(runs):
    found = []
    for seed in range(runs):
        comparison = compare(*fitted(recorded(KBI(), seed=100 + seed)))
        group = comparison.by("direction").groups[0]
        found.append((group.values - list(JOINT.values())) / group.errors)
    spread = np.sqrt(np.mean(np.square(found), axis=0))
    # Of so many draws, at one in a thousand.
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], runs) / runs)
    assert np.all((spread > low) & (spread < high)), spread


# What is not there


def test_without_a_quiet_lead_the_noise_is_unknown():
    bench, candidate = fitted(recorded(*CUBIC, first=LEAD - 5))
    comparison, location = compare(bench, candidate), locate(bench, candidate)
    assert not location.noise_known
    assert not any(view.noise_known for view in location.views.values())
    assert not location.views["frequency"].flags.any()
    assert location.views["direction"].odd_significant
    assert all(row.noise_ratio is None for row in comparison.trials)
    assert comparison.by("amplitude").groups


def test_views_that_are_not_possible_say_so_and_are_not_drawn():
    loads = LOADS[:1]
    trials = recorded(KBI(), loads=loads)
    bench, candidate = fitted(trials)
    comparison, location = compare(bench, candidate), locate(bench, candidate)
    views = location.views
    assert views["direction"].pairs == views["amplitude"].pairs == ()
    assert not views["direction"].panels()
    assert not views["amplitude"].panels()
    assert not views["trials"].panels()
    assert np.isnan(views["frequency"].coherence).all()
    assert not views["frequency"].coherence_known
    assert views["frequency"].panels()
    assert not replace(views["frequency"], noise_known=False).panels()
    assert all(location.sentences)
    for aspect in ("amplitude", "direction", "condition", "trial"):
        found = comparison.by(aspect)
        assert not found.groups
        assert not found.significant
        assert found.p_value == 1.0
        assert found.changes == ()
    assert comparison.by("window").groups
    shown = {panel.get_title(loc="left") for panel in where_figure(location).axes}
    assert shown == {"by time", "by frequency", "by angle", "by velocity"}
    figure = comparison_figure(comparison)
    # One aspect fits in one column.
    assert figure.get_figwidth() == COLUMN
    assert all(panel.get_position().width > 0.6 for panel in figure.axes)


def test_perturbations_of_a_long_record_have_levels_of_their_own():
    """Steps of an imposed angle over a torque whose level wanders from step to step."""
    rng = np.random.default_rng(11)
    n, dwell = 8000, 250
    time = np.arange(n) * 1e-3
    sizes = rng.uniform(0.01, 0.03, n // dwell) * (-1.0) ** np.arange(n // dwell)
    heights = np.repeat(sizes, dwell)
    kernel = np.hanning(41)
    angle = np.convolve(heights, kernel / kernel.sum(), mode="same")
    velocity = np.gradient(angle, 1e-3)
    torque = 80 * angle + 1.0 * velocity + 0.02 * np.gradient(velocity, 1e-3)
    torque = torque + 0.3 * np.sin(2 * np.pi * 0.3 * time) + 0.01 * rng.standard_normal(n)
    trial = Trial(time, torque, angle, driven="angle", name="record")
    bench = Workbench(gather([trial]))
    candidate = bench.fit(KBI(), [{"K": 50.0, "B": 1.0, "I": 0.02}])
    comparison, location = compare(bench, candidate), locate(bench, candidate)
    for aspect in ("window", "amplitude", "direction"):
        for group in comparison.by(aspect).groups:
            assert group.values[0] == pytest.approx(80, rel=0.05), aspect
    assert {g.label for g in comparison.by("direction").groups} == {"positive", "negative"}
    assert location.views["time"].edges[-1] < 0.3
    assert not location.noise_known
    assert location.views["frequency"].driven == "angle"
    where_figure(location)
    responses_figure(bench.split, candidate)


# A view is one file and one line


@dataclass(frozen=True, eq=False)
class ToyView(View):
    """Largest residual of each trial."""

    name = "toy"

    largest: np.ndarray

    @classmethod
    def of(cls, scene):
        return cls(True, scene.noise.known, np.array([b.values.max() for b in scene.blocks]))

    def words(self):
        return f"The largest residual is {self.largest.max():.0f} times the noise."

    def panels(self):
        return (Panel("toy", lambda axes: axes.plot(self.largest)),)


def test_a_view_of_ones_own_is_found_in_location_sentences_record_and_figure():
    bench, candidate = fitted(recorded(*TENDON))
    location = locate(bench, candidate, (TimeView, ToyView))
    toy = location.views["toy"]
    assert toy.largest.size == len(bench.split.fitted)
    assert location.sentences == (location.views["time"].words(), toy.words())
    assert location_record(location)["views"]["toy"]["largest"] == toy.largest.tolist()
    drawn = {axes.get_title(loc="left"): axes for axes in where_figure(location).axes}
    assert drawn["toy"].lines[0].get_ydata() == pytest.approx(toy.largest)


def test_names_of_views_and_titles_of_panels_are_their_own():
    names = [view.name for view in VIEWS]
    assert len(set(names)) == len(names)
    _, location = findings(*TENDON)
    assert list(location.views) == names
    titles = [panel.title for view in location.views.values() for panel in view.panels()]
    assert len(set(titles)) == len(titles) > len(names)


# Records


def test_records_are_json_and_whole():
    loads = LOADS[:1]
    alone = fitted(recorded(KBI(), loads=loads))
    for comparison, location in (findings(*TENDON), (compare(*alone), locate(*alone))):
        record = {
            "comparison": comparison_record(comparison),
            "location": location_record(location),
        }
        assert json.loads(json.dumps(record, allow_nan=False)) == record
        window = comparison.by("window")
        stored = record["comparison"]["constancy"]["window"]
        assert stored["p_value"] == window.p_value
        assert stored["groups"][0]["errors"] == window.groups[0].errors.tolist()
        assert stored["changes"][0]["parameter"] == "K"
        assert record["comparison"]["trials"][0]["error"] == comparison.trials[0].error
        time = location.views["time"]
        found = record["location"]["views"]["time"]
        assert found["edges"] == time.edges.tolist()
        assert found["flags"] == time.flags.tolist()
        for name, view in location.views.items():
            assert set(record["location"]["views"][name]) == {f.name for f in fields(view)}
    assert set(record["location"]["views"]["frequency"]["coherence"]) == {None}


# Rules


def test_the_rules_decide_and_results_carry_what_they_were_judged_by():
    trials = recorded(*TENDON)
    anything = Rules(false_discoveries=1.0, notable=1e6)
    bench = Workbench(gather(trials, trials[:1], rules=anything))
    candidate = bench.fit(KBI(), [JOINT])
    comparison, location = compare(bench, candidate), locate(bench, candidate)
    assert comparison.level == location.level == 1.0
    assert all(c.significant for c in comparison.constancy)
    assert location.views["frequency"].flags.all()
    usual, usually = findings(*TENDON)
    assert usual.level == usually.level == Rules().false_discoveries
    assert not all(c.significant for c in usual.constancy)
    assert not usually.views["frequency"].flags.all()
    # Where no change is clear, the clearest alone is named.
    assert [sum(c.notable for c in a.changes) for a in comparison.constancy] == [1] * 5


# Words


def test_every_result_is_described():
    comparison, location = findings(*TENDON)
    assert len(describe(comparison)) == len(comparison.constancy)
    assert describe(location) == location.sentences
    assert len(set(describe(location))) == len(VIEWS)
    with pytest.raises(InputError, match="Comparison"):
        describe(3)


# Figures


def test_figures_have_a_panel_for_everything_and_labels_with_units():
    comparison, location = findings(*TENDON)
    where = where_figure(location)
    titles = {panel.get_title(loc="left") for panel in where.axes}
    views = ("time", "frequency", "angle", "velocity", "direction", "size", "trial")
    assert {f"by {view}" for view in (*views, "kind of perturbation")} <= titles
    figure = comparison_figure(comparison)
    assert len(figure.axes) == 3 * 5
    assert [figure.axes[5 * i].get_ylabel() for i in range(3)] == [
        "$K$ [Nm/rad]",
        "$B$ [Nms/rad]",
        "$I$ [kg m²]",
    ]
    changed = figure.axes[0].get_title()
    assert "window" in changed
    assert "changes" in changed


def test_a_parameter_at_its_bound_of_zero_has_an_axis_all_the_same():
    comparison, _ = findings(KBI() + StretchReflex(), FAST_REFLEX)
    assert comparison.overall.values[1] == 0.0
    low, high = comparison_figure(comparison).axes[5].get_ylim()
    clear = [g.values[1] for g in comparison.by("window").groups if g.errors[1] < g.values[1]]
    assert clear
    assert low < 0 < max(clear) < high


def test_the_overlay_shows_at_most_eight_trials():
    trials = [t for seed in (1, 2) for t in recorded(*TENDON, seed=seed)]
    bench, before = fitted(trials)
    figure = responses_figure(bench.split, before, before)
    visible = [panel for panel in figure.axes if panel.get_visible()]
    assert len(visible) == 2 * 8
    assert "4 more trials" in figure.get_supxlabel()
    measured, first, _ = visible[0].lines
    ready = bench.split.fitted[0]
    left = np.asarray(measured.get_ydata()) - np.asarray(first.get_ydata())
    assert left == pytest.approx(before.fitted.by_trial[0])
    assert ready.response == pytest.approx(np.asarray(measured.get_ydata()))


def test_the_names_of_long_models_stay_inside_the_figure():
    bench, before = fitted(recorded(*TENDON)[:1])
    keys = ("gravity", "coulomb_friction", "sensor_delay", "sensor_lowpass")
    after = replace(before, model=sum((EFFECTS[key]() for key in keys), KBI()))
    figure = responses_figure(bench.split, before, after)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (legend,) = figure.legends
    box, page = legend.get_window_extent(canvas.get_renderer()), figure.bbox
    assert page.x0 <= box.x0
    assert box.x1 <= page.x1
