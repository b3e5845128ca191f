"""A fit of recorded trials as text, and its record, posterior and figures in a folder."""

from __future__ import annotations

from pathlib import Path

from identifiability.files import write_json
from identifiability.inference.archive import write_netcdf
from identifiability.inference.recordings import Goodness, RecordingFit
from identifiability.inference.records import fit_record
from identifiability.plots.corner import corner_figure
from identifiability.plots.recording import overlay_figure, windows_figure
from identifiability.plots.style import save
from identifiability.report.widths import widths_text


def write_fit(result: RecordingFit, out: Path) -> list[str]:
    """Write record, posterior and figures into a folder; returns the files' names."""
    title = result.prepared[0].trial.name
    if len(result.prepared) > 1:
        title += f" and {len(result.prepared) - 1} more"
    figures = {
        "overlay.png": overlay_figure(result),
        "corner.png": corner_figure(result.widths, result.problem.model, title=title),
    }
    if result.windows:
        figures["windows.png"] = windows_figure(result)
    for name, figure in figures.items():
        save(figure, out / name)
    write_netcdf(result.problem, result.widths, out / "posterior.nc")
    write_json(out / "fit.json", fit_record(result))
    return ["fit.json", *figures, "posterior.nc"]


def fit_text(result: RecordingFit) -> str:
    """What the fit found, as text."""

    def quality(goodness: Goodness) -> str:
        return f"E = {goodness.error:.3g}, VAF = {goodness.vaf:.2f} %"

    least = result.least_squares
    values = ", ".join(f"{n} {least[n]:.4g}" for n in least.names)
    apart = ", ".join(
        f"{row.name} {abs(least[row.name] - row.optimum) / row.posterior_sd:.1f}"
        for row in result.widths.rows
    )
    lines = [
        widths_text(result.widths),
        "",
        *_noise_lines(result),
        f"least squares (smallest E): {values}; {quality(result.goodness)}",
        f"the two are apart by so many widths: {apart}",
    ]
    for row in result.widths.rows:
        lines.append(f"{row.name}: {row.verdict}, {row.reason}")
    for w in result.windows:
        values = ", ".join(
            f"{r.name} {r.optimum:.4g} ± {r.posterior_sd:.2g}" for r in w.widths.rows
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
