"""Next experiment, smallest visible effects, record, report and figures of an investigation."""

import json
import re
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from browser import assert_laid_out
from browser import measured as measured_in_browser
from hidden import CONDITIONS, HELD, JOINT, trials

from identifiability.files import plain
from identifiability.inference.recordings import fit_recordings
from identifiability.investigation.fits.candidate import NOTHING, Candidate
from identifiability.investigation.investigate import investigate
from identifiability.investigation.ladder.found import Found, Tried
from identifiability.investigation.next_experiment import (
    Design,
    Limits,
    NextExperiment,
    next_experiment,
)
from identifiability.investigation.record import investigation_record
from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation
from identifiability.investigation.unexplained.readouts import StaticMap
from identifiability.investigation.verdict.pinned import not_pinned_down
from identifiability.investigation.wording.numbers import error_text, measured, times
from identifiability.investigation.wording.pinned import loose_sentence
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.numerals import range_text
from identifiability.plots.investigation import alone_figure, widths_figure
from identifiability.plots.style import COLUMN, PAGE, PRINTED_AS
from identifiability.report.fit import write_fit
from identifiability.report.investigation import (
    investigation_text,
    write_investigation,
    write_report,
)
from identifiability.report.page import Page
from identifiability.report.ranking import tried_row

QUADRATIC = EFFECTS["quadratic_stiffness"].parameters
SMALL = {k: EFFECTS[k] for k in ("quadratic_stiffness", "cubic_stiffness")}
STATES = np.linspace(-0.123, 0.123, 9)
MAP = StaticMap(STATES, 10 * STATES, np.outer(STATES, STATES + 0.2), np.full((9, 9), 1e-3))
FEW = CONDITIONS[::3]  # a pulse and a step, where it is not their number that counts


@pytest.fixture(scope="module")
def quiet_study():
    return Investigation(
        trials(KBI(), JOINT), trials(KBI(), JOINT, seed=9, conditions=HELD), library=SMALL
    )


def test_a_larger_torque_tells_springs_apart_better(quiet_study):
    """Cubic against quadratic stiffness: evidence grows with the size of the motion."""
    study = quiet_study
    shared = JOINT | {"cubic_stiffness.coefficient": 5.0, "cubic_stiffness.centre": 0.0}
    cubic = KBI() + EFFECTS["cubic_stiffness"]()
    candidate = replace(
        study.fit(KBI()),
        model=cubic,
        values=shared,
        free=cubic.parameter_names,
        scheme=None,
    )
    rival = study.fit(KBI() + EFFECTS["quadratic_stiffness"]())
    pair = ("cubic_stiffness", "quadratic_stiffness")
    results = [
        next_experiment(study.bench, candidate, rival, pair, limits=Limits(torque, 3.0, 0.5))
        for torque in (8.0, 16.0)
    ]
    small, large = (r.best.expected_evidence for r in results)
    assert large > 4 * small > 0
    for r in results:
        for design in (r.best, *r.others):
            assert design.amplitude == design.peak_torque <= r.limits.torque
            assert design.peak_angle <= r.limits.angle
        assert r.resolved == (r.best.expected_evidence >= Rules().resolved)


def test_an_imposed_motion_keeps_within_the_limit_of_torque():
    moved = [replace(t, driven="angle") for t in trials(KBI(), JOINT)]
    study = Investigation(moved, lowpass_hz=None, library=SMALL)
    first, second = (
        study.fit(KBI() + EFFECTS[f"{kind}_stiffness"]()) for kind in ("cubic", "quadratic")
    )
    for most in (50.0, 5.0):
        limits = Limits(torque=most, angle=0.5, duration=0.5)
        found = next_experiment(study.bench, first, second, ("cubic", "quadratic"), limits=limits)
        designs = (found.best, *found.others)
        assert len(designs) > 5
        for design in designs:
            assert design.amplitude == design.peak_angle <= limits.angle
            assert design.peak_torque <= limits.torque
        # A servo at its full angle would need more torque than it may.
        assert min(design.peak_angle for design in designs) < limits.angle


@pytest.mark.parametrize(
    ("verdict", "shown"),
    [
        ("agrees", ["slice (others held)", "profile", "posterior sd"]),
        ("not converged", ["slice (others held)", "profile"]),
    ],
)
def test_the_widths_figure_names_the_widths_that_there_are(verdict, shown):
    row = SimpleNamespace(
        name="K",
        optimum=-2.0,
        slice=0.1,
        quadratic=np.nan,
        profile=0.3,
        posterior_sd=0.2,
        verdict=verdict,
    )
    figure = widths_figure(SimpleNamespace(rows=[row]))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == shown
    slices = figure.axes[0].lines[0].get_xdata()
    assert slices == pytest.approx([0.05])


@pytest.mark.parametrize(
    ("optimum", "interval", "sides", "said"),
    [
        (1.0, (0.6, 1.4), ("closed", "closed"), ""),
        (1.0, (0.3, 1.7), ("closed", "closed"), "hardly known: anywhere from 0.3 to 1.7 Nm/rad"),
        (1.0, (0.6, 1.4), ("closed", "open"), "do not bound K above"),
        # At zero every interval is wide against the value; how small it must be is what is known.
        (0.0, (0.001, 0.04), ("bound", "closed"), "small, or nothing at all: at most 0.04 Nm/rad"),
        (0.02, (0.001, 0.04), ("bound", "closed"), "hardly known"),
        (0.0, (0.001, 0.04), ("bound", "open"), "do not bound K above"),
    ],
)
def test_what_is_said_of_a_parameter_that_is_not_pinned_down(optimum, interval, sides, said):
    row = SimpleNamespace(
        name="K",
        unit="Nm/rad",
        optimum=optimum,
        posterior_95=interval,
        profile_sides=sides,
        verdict="agrees",
    )
    found = " ".join(loose_sentence(p) for p in not_pinned_down(SimpleNamespace(rows=[row]), 0.5))
    assert (said in found) if said else not found


def test_a_prediction_that_explodes_is_called_so():
    assert error_text(0.01234) == "0.0123"
    assert error_text(0.01234, 2) == "0.012"
    assert error_text(1.23e-5) == "1.23 × 10⁻⁵"
    assert error_text(1e197) == error_text(np.inf) == "diverges"


@pytest.mark.parametrize(
    ("value", "sd", "at_bound", "said"),
    [
        (31.98, 0.034, False, "31.980 ± 0.034 Nm/rad"),
        (31.98, 0.34, False, "31.98 ± 0.34 Nm/rad"),
        (30.0001, 0.0149, False, "30.000 ± 0.015 Nm/rad"),
        (30.0001, 0.0019, False, "30.00 Nm/rad ± 0.006 %"),
        (1.2345e-5, 2.1e-6, False, "(1.23 ± 0.21) × 10⁻⁵ Nm/rad"),
        (2.5e6, 3e5, False, "(2.50 ± 0.30) × 10⁶ Nm/rad"),
        (12.3456, None, False, "12.35 Nm/rad"),
        (1.915e-12, None, False, "0 Nm/rad"),
        (1.915e-12, None, True, "0 Nm/rad (at its bound)"),
        (2000.0, None, True, "2000 Nm/rad (at its bound)"),
    ],
)
def test_a_value_has_the_digits_that_mean_something(value, sd, at_bound, said):
    assert measured(value, sd, KBI().parameters["K"], at_bound=at_bound) == said


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (29.9989, 30.0036, "29.9989 to 30.0036"),
        (1.0, 30.0, "1 to 30"),
        (1.1e-6, 2.3e-6, "1.1 × 10⁻⁶ to 2.3 × 10⁻⁶"),
        (0.0, 0.0, "0 to 0"),
        (-np.inf, 2.0, "unknown to 2"),
    ],
)
def test_the_ends_of_a_range_are_told_apart(low, high, said):
    assert range_text(low, high) == said


@pytest.mark.parametrize(
    ("nats", "said"), [(0.0, "1"), (3.0, "20"), (-3.0, "0.05"), (46.05, "10²⁰"), (-46.05, "10⁻²⁰")]
)
def test_evidence_is_said_as_odds(nats, said):
    assert times(nats) == said


def test_every_effect_lies_within_the_axes(quiet_study):
    base = quiet_study.fit(KBI())
    failed = Candidate(KBI() + EFFECTS["gravity"](), {}, (), NOTHING, NOTHING)
    alone = (
        Tried("quadratic_stiffness", with_effect(base, "quadratic_stiffness"), 50.0, 0.01, 0.9),
        Tried("cubic_stiffness", with_effect(base, "cubic_stiffness"), -3.0, 0.02, 0.0),
        Tried("gravity", failed, 0.0, 1.0, 0.0, "no"),
    )
    axes = alone_figure(Found(base, alone, base, (), None, 3), ["quadratic_stiffness"]).axes[0]
    texts = [t for t in axes.texts if t.get_text()]
    assert [t.get_text() for t in texts] == [
        "leaves 1 % of the energy",
        "leaves 2 % of the energy",
        "no fit",
    ]
    low, high = sorted(axes.get_ylim())
    assert all(low + 0.3 < t.xy[1] < high - 0.3 for t in texts)
    # What is named is filled.
    assert [bar.get_facecolor()[3] > 0 for bar in axes.patches] == [True, False]


def with_effect(candidate, key):
    return replace(candidate, model=KBI() + EFFECTS[key]())


def test_pulses_shorter_than_the_sampling_interval_are_not_proposed(quiet_study):
    slow = [t.decimate(10) for t in trials(KBI(), JOINT)]
    study = Investigation(slow, library=SMALL)
    found = next_experiment(
        study.bench,
        study.fit(KBI() + EFFECTS["cubic_stiffness"]()),
        study.fit(KBI() + EFFECTS["quadratic_stiffness"]()),
        ("cubic", "quadratic"),
        limits=Limits(8.0, 3.0, 0.5),
    )
    words = " ".join(d.perturbation for d in (found.best, *found.others))
    assert "pulse of 20 ms" in words
    assert "pulse of 5 ms" not in words


@pytest.fixture(scope="module")
def explained():
    """Findings of a joint with a cubic spring, by a library in which one effect explodes."""

    class Explosive(EFFECTS["cubic_stiffness"]):
        key = "explosive"

        def torque(self, p, motion, states, delayed):
            return p[0] * motion.angle / 0.0

    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    fitted, held_out = (
        [replace(t, name=f"elbow_of_subject_07_{part}_{t.name}") for t in several]
        for part, several in (
            ("run", trials(model, values, conditions=FEW)),
            ("other", trials(model, values, seed=9, conditions=HELD[:1])),
        )
    )
    return investigate(fitted, held_out, library=SMALL | {"explosive": Explosive}, seed=3)


@pytest.fixture(scope="module", params=["one_of", "unknown_static"])
def reported(request, explained, tmp_path_factory):
    """The same as two kinds of verdict: folder, findings, record, and the figures' names."""
    findings, kind = explained, request.param
    found = findings.found
    if kind == "one_of":
        key = "quadratic_stiffness"
        model = KBI() + EFFECTS[key]()
        other = replace(
            found.baseline,
            model=model,
            values=dict(zip(model.parameter_names, model.nominal, strict=True)),
            free=model.parameter_names,
        )
        missing = replace(found.missing[0], could_be=(found.missing[0].key, key), instead=(other,))
        verdict = replace(findings.verdict, kind=kind, sets=(missing.could_be,))
        best = Design("a step with a torque of 4 Nm", 4.0, 0.2, 4.0, 33.0)
        following = NextExperiment(missing.could_be, best, (), Limits(8.0, 0.3, 0.5), 20.0)
        findings = replace(
            findings,
            found=replace(found, missing=(missing,)),
            verdict=verdict,
            next_experiment=following,
        )
    if kind == "unknown_static":
        findings = replace(
            findings,
            found=replace(found, missing=(), final=found.baseline, nearest=found.final),
            posterior=replace(
                findings.posterior, screened={("cubic_stiffness", "quadratic_stiffness"): 53.0}
            ),
            verdict=replace(findings.verdict, kind=kind, sets=()),
            unexplained_after=replace(findings.unexplained_before, static_map=MAP),
        )
    folder = tmp_path_factory.mktemp(kind)
    record = investigation_record(findings, command="identifiability investigate trials")
    with pytest.MonkeyPatch.context() as patched:
        if kind != "one_of":
            patched.setattr("identifiability.plots.style.PRINTED_AS", (".svg",))
        figures = write_report(findings, record, folder)
    return SimpleNamespace(folder=folder, findings=findings, record=record, figures=figures)


def test_a_failed_candidate_is_shown_and_does_not_stop_the_rest(explained):
    findings = explained
    assert findings.warnings == ()
    assert findings.verdict.kind == "explained"
    assert findings.verdict.effects == ("cubic_stiffness",)
    record = investigation_record(findings, command="identifiability investigate trials")
    assert record["steps"][-1]["error_held_out"] < 0.1 * record["baseline"]["error_held_out"]
    failures = [c for step in record["rankings"] for c in step["candidates"] if "failure" in c]
    assert next(c["effect"] for c in failures) == "explosive"
    json.dumps(record, allow_nan=False)
    assert record["rules"] == asdict(Rules())
    # A rival's curve can be drawn again: every value of its model is there.
    rivals = [c for step in record["steps"] for c in step["in_its_place"]]
    assert [r["effect"] for r in rivals] == ["quadratic_stiffness"]
    assert set(rivals[0]["parameters"]) == {*JOINT, *rivals[0]["parameters"]}
    assert all(f"quadratic_stiffness.{p.name}" in rivals[0]["parameters"] for p in QUADRATIC)
    assert record["comparison"]
    assert record["location"]


def test_a_report_holds_what_its_verdict_needs(reported):
    page = (reported.folder / "report.html").read_text()
    kind = reported.findings.verdict.kind
    assert "could not be drawn" not in page
    assert "no fit" in page
    assert re.findall("<h2>(.*?)</h2>", page) == [
        "Why",
        "The error on data that were not fitted",
        "The torque that is missing",
        "Where K, B and I fail",
        "What may be missing, by probability",
        "Parameters and their widths",
        *(["Next experiment"] if kind == "one_of" else []),
        "How this was computed",
    ]
    # What was left out of a long record's weighing, and the nearest of what is known.
    assert ("nearest known: K, B, I + cubic stiffness" in page) == (kind == "unknown_static")
    assert ("53 nats or more behind the best of as many" in page) == (kind == "unknown_static")
    assert len(reported.record["weighed"]["begun_only"]) == (kind == "unknown_static")
    # Nothing is fetched from elsewhere, and every figure is there in all formats.
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    shown = sorted(name for name in reported.figures if name.endswith(".svg"))
    assert page.count("data:image/svg+xml;base64,") == len(shown)
    if kind == "one_of":
        every = {name.replace(".svg", suffix) for name in shown for suffix in PRINTED_AS}
        assert set(reported.figures) == every
    assert all((reported.folder / name).stat().st_size for name in reported.figures)
    names = {name.rpartition("/")[2].partition(".")[0] for name in reported.figures}
    assert ("rivals_cubic_stiffness_quadratic_stiffness" in names) == (kind == "one_of")
    # Of an unknown effect the best picture comes before all reasons.
    above = page[: page.index("<h2>")]
    assert ("<figure" in above) == (kind == "unknown_static")
    # Keys and numbers are for programs.
    for text in re.findall(r"<(?:td|th|p|li)[^>]*>(.*?)</", page):
        assert not re.search(r"\d[eE][-+]\d", text), text
        assert not any(key in text for key in EFFECTS if "_" in key), text


def test_figures_are_as_wide_as_a_journal_prints_them_and_their_letters_can_be_read(reported):
    for name in reported.figures:
        if not name.endswith(".svg"):
            continue
        drawn = (reported.folder / name).read_text()
        width = float(re.search(r'<svg [^>]*width="([\d.]+)pt"', drawn)[1]) / 72
        assert any(width == pytest.approx(one, abs=0.01) for one in (COLUMN, PAGE)), name
        # Letters are paths, a hundred units high.
        sizes = [100 * float(size) for size in re.findall(r"scale\(([\d.]+) -[\d.]+\)", drawn)]
        assert min(sizes) >= 7, name


def test_a_browser_lays_a_report_out_whole(reported, tmp_path):
    drawings = [reported.folder / name for name in reported.figures if name.endswith(".svg")]
    assert_laid_out(reported.folder / "report.html", drawings, tmp_path)


@pytest.mark.usefixtures("shown_alone")
def test_a_browser_lays_the_report_of_a_fit_out_whole(tmp_path):
    result = fit_recordings(trials(KBI(), JOINT, conditions=FEW), window_lengths=(0.1, 0.2))
    drawings = [tmp_path / name for name in write_fit(result, tmp_path) if name.endswith(".svg")]
    assert_laid_out(tmp_path / "report.html", drawings, tmp_path)


def test_the_browser_sees_what_is_wrong(tmp_path):
    page = Page("a" * 300)
    page.paragraph("first")
    worse = "h1 { overflow-wrap: normal; } p { margin-top: -1.5rem; }</style>"
    (tmp_path / "page.html").write_text(page.render().replace("</style>", worse))
    texts = "".join(
        f'<g id="text_{name}"><!-- {name} --><g transform="translate({x} 20)">'
        '<path d="M0 0h30v9h-30z"/></g></g>'
        for name, x in (("a", 10), ("b", 30), ("c", 80))
    )
    (tmp_path / "bad.svg").write_text(f'<svg width="100" height="50">{texts}</svg>')
    found = measured_in_browser(
        tmp_path / "page.html", [tmp_path / "bad.svg"], tmp_path, widths=(400,), dark=True
    )
    (shown, printed), (drawing,) = found["pages"], found["drawings"]
    assert printed["outside"]
    assert printed["background"] == "rgb(255, 255, 255)"
    assert shown["scrolls"]
    assert shown["outside"]
    assert shown["overlapping"]
    assert shown["background"] == "rgb(22, 25, 29)"
    assert drawing["overlapping"] == ["a | b"]
    assert drawing["cut"] == ["c"]


@pytest.mark.parts_fail
@pytest.mark.usefixtures("no_smallest_effects", "shown_alone")
def test_a_part_that_fails_is_told_and_takes_no_other_with_it(tmp_path, monkeypatch):
    def fails(*args):
        raise ValueError("the trials are of no use")

    monkeypatch.setattr("identifiability.investigation.session.compare", fails)
    few = trials(KBI(), JOINT, conditions=FEW)
    findings = investigate(few, library=SMALL, most=0, with_widths=False)
    assert findings.failures == {"comparison": "the trials are of no use"}
    assert findings.warnings == ("comparison: the trials are of no use",)
    assert findings.comparison is None
    assert findings.location is not None
    written = write_investigation(findings, tmp_path, command="")
    assert not [name for name in written if "comparison" in name]
    record = json.loads((tmp_path / "investigation.json").read_text())
    assert record["failures"] == findings.failures
    assert (tmp_path / "report.html").read_text().count("the trials are of no use") == 2
    assert "the trials are of no use" in investigation_text(findings)


def test_a_number_without_unit_keeps_its_digits(quiet_study):
    # The unit of such a number is "1", which is not to be taken off its end.
    base = quiet_study.fit(KBI())
    model = KBI() + EFFECTS["nonlinear_tendon"]()
    own = dict(zip(model.parameter_names[3:], (150.0, 11.0, 0.51, 4.2, 0.3), strict=True))
    found = replace(base, model=model, values=JOINT | own, free=model.parameter_names)
    row = tried_row(Tried("nonlinear_tendon", found, 12.0, 0.1, 0.5), 0.7)
    assert row[1:4] == ["physics", "70 %", "10⁵"]
    assert row[-1] == (
        "stiffness 150 Nm/rad, hardening 11 1/rad, asymmetry 0.51, bypass stiffness 4.2 Nm/rad, "
        "bypass damping 0.3 Nms/rad"
    )


def test_plain_knows_what_json_does_not():
    found = plain({"a": np.float64("nan"), "b": (np.int64(2), np.bool_(True)), "c": float("inf")})
    assert found == {"a": None, "b": [2, True], "c": None}
    json.dumps(found)
