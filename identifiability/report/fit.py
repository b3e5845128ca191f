"""A fit of recorded trials as text and page, and its record, posterior and figures in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from identifiability.files import write_json, write_text
from identifiability.inference.archive import write_netcdf
from identifiability.inference.consistency import Consistency, Structural, consistency
from identifiability.inference.recordings import Goodness, RecordingFit
from identifiability.inference.records import fit_record
from identifiability.inference.widths import Width
from identifiability.investigation.wording.numbers import vaf_text
from identifiability.investigation.wording.values import width_in_words
from identifiability.joint.parameters import plus_minus
from identifiability.numerals import number
from identifiability.plots.corner import corner_figure
from identifiability.plots.recording import overlay_figure, windows_figure
from identifiability.report.figures import Figures
from identifiability.report.page import Page
from identifiability.report.widths import widths_text


def write_fit(result: RecordingFit, out: Path) -> list[str]:
    """Write record, posterior, report and figures into a folder; returns the files' names."""
    title = result.prepared[0].trial.name
    if len(result.prepared) > 1:
        title += f" and {len(result.prepared) - 1} more"
    write_netcdf(result.problem, result.widths, out / "posterior.nc")
    write_json(out / "fit.json", fit_record(result))
    return ["report.html", "fit.json", "posterior.nc", *_write_report(result, title, out)]


def answer(found: Consistency) -> str:
    """Whether K, B and I are properties of what was recorded, in a sentence or two."""
    if found.kind == "the same":
        return (
            f"K, B and I are the same in whole records, in windows of {_times(found.windows)} and "
            "by least squares, as far as their uncertainties tell."
        )
    if found.kind == "not tested":
        return (
            "K, B and I of whole records agree with least squares; whether they depend on the "
            "window was not tested (--window)."
        )
    one, *others = found.notable
    first, second = (f"{plus_minus(r.value, r.sd)} {one.unit}" for r in (one.first, one.second))
    if found.kind == "depends on the weights":
        said = (
            f"{one.name} is {first} where every sample weighs alike, and {second} weighed by the "
            "noise"
        )
    else:
        falls = "falls" if one.second.value < one.first.value else "rises"
        until = one.second.window
        said = (
            f"{one.name} {falls} from {first} to {second} as the window grows from "
            f"{_times([one.first.window or 0.0])} to "
            + ("whole records" if until is None else _times([until]))
        )
    also = f" Neither {'is' if len(others) == 1 else 'are'} " + " and ".join(o.name for o in others)
    return f"{said}: it is not a property of this joint." + (f"{also}." if others else "")


def structural(found: Consistency) -> str:
    """Statistical width of K, B and I, and beside it their structural error, in a line."""

    def said(one: Structural) -> str:
        width = number(one.width, 2)
        if not one.error:
            return f"{one.name} {width} {one.unit} and none seen"
        return f"{one.name} {width} and {number(one.error, 2)} {one.unit}"

    return ", ".join(map(said, found.structural))


def advice(found: Consistency) -> str:
    """What to do next."""
    if found.kind == "the same":
        return (
            "Quote K, B and I with their widths. Whether they miss something small: "
            "identifiability investigate, with the same files."
        )
    if found.kind == "not tested":
        return (
            "Fit windows too (--window 0.05 0.1), or records that go on longer after each "
            "perturbation."
        )
    return (
        "Do not quote K, B and I. What they miss: identifiability investigate, with the same files."
    )


def _times(windows: Sequence[float]) -> str:
    *most, last = [f"{1000 * w:g}" for w in windows]
    return (f"{', '.join(most)} and " if most else "") + f"{last} ms"


_WIDTHS = ("slice", "quadratic", "gauss_newton", "sandwich", "profile", "posterior_sd")


def _write_report(result: RecordingFit, title: str, out: Path) -> list[str]:
    """Answer, parameters by every way to fit them, figures; returns the figures' names."""
    page = Page(f"K, B and I of {title}")
    figures = Figures(page, out)
    found, held = consistency(result), result.held_out
    values = ", ".join(f"{r.name} = {_value(r)}" for r in result.widths.rows)
    box = [("K, B and I of whole records", f"{values}.")]
    if held is not None:
        box.append(
            (
                "Not fitted",
                f"Fitted to {held.fitted}, they explain {_vaf(held.goodness_fitted)} % of the "
                f"variance there, and {_vaf(held.goodness_held_out)} % on {held.held_out}, which "
                "was not fitted.",
            )
        )
    box.append(("Statistical width and structural error", f"{structural(found)}."))
    page.box(answer(found), [*box, ("Next", advice(found))])
    _values(page, result, found)
    page.items([*_noise_lines(result), *(f"note: {warning}" for warning in result.warnings)])
    figures.show(
        "overlay",
        lambda: overlay_figure(result),
        f"What was imposed, what was measured and fitted, and what the fit leaves: E = "
        f"{number(result.goodness.error)}, VAF = {_vaf(result.goodness)} %.",
        "Curves of the imposed signal, of the measured and fitted response, and of the residual.",
    )
    if result.windows:
        figures.show(
            "windows",
            lambda: windows_figure(result),
            "K, B and I by window, with 95 % intervals; grey: whole records. A joint that is K, B "
            "and I has the same ones in every window.",
            f"Estimates of K, B and I in windows of {_times([w.window for w in result.windows])}.",
        )
    figures.show(
        "corner",
        lambda: corner_figure(result.widths, result.problem, title=title),
        "Posterior of K, B and I, with the ellipse of the quadratic estimate.",
        "Contours of the posterior of each two of K, B and I, and its histogram of each.",
    )
    _ellipse(page, result)
    figures.show_cuts(result.prepared)
    write_text(out / "report.html", page.render())
    return figures.written


def _value(row: Width) -> str:
    return f"{plus_minus(row.optimum, row.posterior_sd)} {row.unit}"


def _vaf(goodness: Goodness) -> str:
    return vaf_text(1 - goodness.vaf / 100)


def _values(page: Page, result: RecordingFit, found: Consistency) -> None:
    """K, B and I by every way to fit them."""
    rows, held, least = result.widths.rows, result.held_out, result.least_squares
    table = [["whole records", *(plus_minus(r.optimum, r.posterior_sd) for r in rows), ""]]
    for w in result.windows:
        values = [plus_minus(r.optimum, r.posterior_sd) for r in w.widths.rows]
        table.append([f"windows of {_times([w.window])}", *values, _vaf(w.goodness)])
    values = [number(least[r.name], 4) for r in rows]
    table.append(["whole records, least squares", *values, _vaf(result.goodness)])
    if held is not None:
        values = [number(held.fit[r.name], 4) for r in rows]
        vaf = f"{_vaf(held.goodness_held_out)} on {held.held_out}"
        table.append([f"{held.fitted}, least squares", *values, vaf])
    errors = [number(one.error, 2) if one.error else "none seen" for one in found.structural]
    table.append(["structural error", *errors, ""])
    page.table(
        ["fitted to", *(f"{r.name} [{r.unit}]" for r in rows), "VAF [%]"],
        table,
        text_columns=(0, 4),
    )
    page.paragraph(
        "± is one standard deviation of the posterior, with level and colour of the noise of both "
        "channels estimated beside K, B and I. It is the uncertainty of K, B and I only if the "
        "joint is K, B and I: what the model misses counts as noise. The structural error is how "
        "far windows, whole records and least squares differ beyond that; what is wrong alike in "
        "all of them is not in it."
    )


def _ellipse(page: Page, result: RecordingFit) -> None:
    """All widths side by side."""
    rows = result.widths.rows
    page.heading("Whether the ellipse is the width")
    page.paragraph(
        "Standard deviations: slice (all others held), quadratic (the paper's estimate, by the "
        "full Hessian, by Gauss-Newton and as sandwich), profile and posterior."
    )
    page.table(
        ["parameter", *(w.replace("_", " ").replace(" sd", "") for w in _WIDTHS), "the ellipse"],
        [
            [
                f"{r.name} [{r.unit}]",
                *(number(getattr(r, w)) for w in _WIDTHS),
                width_in_words(r.verdict),
            ]
            for r in rows
        ],
        text_columns=(7,),
    )
    page.items([f"{r.name}: {r.reason}." for r in rows])


def fit_text(result: RecordingFit) -> str:
    """What the fit found, as text."""

    def quality(goodness: Goodness) -> str:
        return f"E = {goodness.error:.3g}, VAF = {goodness.vaf:.2f} %"

    found, least = consistency(result), result.least_squares
    values = ", ".join(f"{n} {least[n]:.4g}" for n in least.names)
    apart = ", ".join(
        f"{row.name} {abs(least[row.name] - row.optimum) / row.posterior_sd:.1f}"
        for row in result.widths.rows
    )
    lines = [
        answer(found),
        advice(found),
        "",
        widths_text(result.widths),
        f"statistical width and structural error: {structural(found)}",
        "",
        *_noise_lines(result),
        f"least squares (smallest E): {values}; {quality(result.goodness)}",
        f"the two are apart by so many widths: {apart}",
    ]
    for row in result.widths.rows:
        lines.append(f"width of {row.name}: {width_in_words(row.verdict)}, {row.reason}")
    for w in result.windows:
        values = ", ".join(
            f"{r.name} {plus_minus(r.optimum, r.posterior_sd)}" for r in w.widths.rows
        )
        lines.append(
            f"T = {1000 * w.window:g} ms ({w.n_windows} windows): {values}; "
            f"VAF {w.goodness.vaf:.2f} %"
        )
    if result.held_out is not None:
        held = result.held_out
        lines.append(f"fitted to {held.fitted}: {quality(held.goodness_fitted)} there, and")
        lines.append(f"{quality(held.goodness_held_out)} on {held.held_out}, which was not fitted")
    lines += [f"note: {warning}" for warning in result.warnings]
    return "\n".join(lines)


def _noise_lines(result: RecordingFit) -> list[str]:
    """The noise that the widths are computed for."""
    driven = result.prepared[0].trial.driven
    here, there = ("angle", "torque") if driven == "torque" else ("torque", "angle")
    units = {"angle": "rad", "torque": "Nm"}
    lines = []
    noisy = result.with_noise
    for i, noise in enumerate(noisy.noises):
        interval = noisy.problem.observations[noisy.which.index(i)].drive.interval
        colour = "white" if noise.own.ar.size == noise.own.ma.size == 1 else "coloured"
        found = f"noise: {noise.rms:.2g} {units[here]} rms in the {here}, its own part {colour}"
        if noise.carried is not None:
            found += (
                f"; {noise.carried_sd:.2g} {units[there]} in the {there}, at {1 / interval:.4g} Hz"
            )
        lines.append(found)
    if noisy.corrected:
        lines.append("what noise of the imposed angle takes off K, B and I is put back")
    return lines
