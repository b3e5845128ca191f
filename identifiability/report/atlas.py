"""The page of the atlas, made from the record of `study.atlas_record` alone."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from identifiability.inference.curvature import NORMAL_95
from identifiability.inference.widths import VERDICTS
from identifiability.provenance import made_by
from identifiability.report.markdown import number, percent, table, words
from identifiability.study.atlas_record import AWAY

Record = Mapping[str, Any]

MOST_LISTED = 20

_AXES = {
    "perturbation": "Perturbation",
    "ratio": "K_SE / K_CE",
    "K_CE": "K_CE [Nm/rad]",
    "B_CE": "B_CE [Nms/rad]",
}


def page(record: Record) -> str:
    """Render the page.

    Parameters
    ----------
    record : mapping
        From `atlas_record.record`.

    Returns
    -------
    str
        Markdown.
    """
    sections = [_head(record)]
    if record["cells"]["done"]:
        sections += [
            _answer(record),
            _tracking(record),
            _verdicts(record),
            _ratios(record),
            _why(record),
            _conventions(record),
            _structural(record),
            _claims(record),
            _trust(record),
        ]
    sections += [_failed(record), _posteriors(record), _maps(record), _again(record)]
    return "\n\n".join(_filled(section.strip()) for section in sections if section) + "\n"


def _head(record: Record) -> str:
    plan, cells = record["plan"], record["cells"]
    durations = _listed(f"{1000 * T:g}" for T in plan["T"])
    noise = "white"
    if plan["correlation_time"]:
        noise = (
            f"first-order autoregressive (correlation time {1000 * plan['correlation_time']:g} ms)"
        )
    return f"""\
# Does the spread of K, B and I follow the Hessian?

A joint with known muscle and tendon is perturbed, stiffness K, damping B and inertia I are fitted
to its response, and the question is how well the response determines them. The usual answer, also
that of Kistemaker & Rozendaal (2011), is an ellipse from the curvature (Hessian) of the error at
its minimum. This page compares it with the full posterior distribution, sampled by MCMC within the
bounds that any joint has (K and B not below zero), in {cells["done"]} of {cells["total"]} cells:
{len(plan["K_CE"])} stiffnesses x {len(plan["B_CE"])} dampings of the muscle (K_CE
{_range(plan["K_CE"], "Nm/rad")}, B_CE {_range(plan["B_CE"], "Nms/rad")}), tendons of K_SE =
{_listed(f"{r:g}" for r in plan["ratio"])} K_CE, I = 0.1 kg m², the response to
{_listed(words(p) for p in plan["perturbations"])} over {durations} ms, sampled at
{plan["rate"]:g} Hz, with {noise} noise in {len(plan["readings"])} readings of the paper's
ΔE = {plan["dE"]:g}. *contour*: one standard deviation along the least certain direction is the
paper's change of parameters (Eq. 15). *energy*: the noise itself has an error E of ΔE, which is
less noise, the less the more samples there are."""


def _answer(record: Record) -> str:
    """What was found, in the order in which it is asked."""
    lines = []
    for reading in dict.fromkeys(group["reading"] for group in record["tracking"]):
        found = {T: _of_all(record, reading, T, "within_tenth") for T in record["plan"]["T"]}
        shares = [f"{percent(v)} at {_milliseconds(T)}" for T, v in found.items() if v is not None]
        slopes = [
            group["slope"]["value"]
            for group in _tracked(record, reading)
            if group["prediction"] == "quadratic" and group["slope"]
        ]
        if not slopes:
            continue
        lines.append(
            f"- **{reading.capitalize()} noise.** Of the posterior's standard deviations, "
            f"{_listed(shares)} are within a tenth of the quadratic width. Their logarithms "
            f"follow it with slopes of {min(slopes):.2f} to {max(slopes):.2f} (1 is proportion)."
        )
    near = [
        [
            c
            for group in record["distances"]
            for c in group["classes"]
            if (c["from"] < AWAY) is close
        ]
        for close in (True, False)
    ]
    (close, close_of), (far, far_of) = (
        (sum(c["agrees"] for c in classes), sum(c["of"] for c in classes)) for classes in near
    )
    lines.append(
        f"- **Where not, and why.** Where the optimum lies less than {AWAY:g} quadratic widths "
        f"from an impossible value, the ellipse holds in {_share(close, close_of)} of the cells, "
        f"since the bound cuts it; elsewhere in {_share(far, far_of)}, and what is left is bent: "
        "the error is no parabola over the width of the posterior. *Holds* is strict: widths to "
        f"{percent(record['criteria']['width_tolerance'])}, ends of the 95 % interval to "
        f"{record['criteria']['end_tolerance']:g} widths, for K, B and I at once."
    )
    for group in record["structural"]:
        if group["reading"] != record["structural"][-1]["reading"]:
            continue
        slow = group["slow"]
        lines.append(
            f"- **What no width says** ({group['reading']} noise, {_milliseconds(group['T'])}). "
            f"The fitted K differs from the stiffness that a slow perturbation meets by "
            f"{_percent_signed(slow['q50'])} in the median ({_percent_signed(slow['q5'])} to "
            f"{_percent_signed(slow['q95'])}), which is {slow['sds']:.1f} posterior standard "
            f"deviations; in {percent(slow['beyond_two_sd'])} of the cells it is more than two."
        )
    lines.append(
        "- **What it hangs on.** The tolerance, below; sampling rate, correlation and draw of the "
        "noise, bounds, a known inertia and the choice of coordinates: `identifiability "
        "sensitivity` (`results/sensitivity.md`)."
    )
    return "## The answer\n\n" + "\n".join(lines)


def _tracked(record: Record, reading: str) -> list[Record]:
    return [g for g in record["tracking"] if g["reading"] == reading and "slope" in g]


def _of_all(record: Record, reading: str, T: float, name: str) -> float | None:
    """Share over the three parameters of the cells of a reading and duration."""
    groups = [
        g for g in _tracked(record, reading) if g["T"] == T and g["prediction"] == "quadratic"
    ]
    if not groups:
        return None
    whole = sum(g["of"] for g in groups)
    return float(sum(g[name]["value"] * g["predicted"] for g in groups) / whole)


def _share(n: int, of: int) -> str:
    return f"{n} of {of} ({percent(n / of)})" if of else "none of none"


def _tracking(record: Record) -> str:
    text = """\
## Does posterior spread follow the prediction?

Of each parameter: the correlation and the slope of the logarithm of the posterior's standard
deviation against that of the prediction, the median of their ratio, and the share of cells in
which they are within a tenth, and within a factor of two, of each other. Intervals (95 %) are by
resampling the musculoskeletal models. *Eq. 15* is the paper's largest change of the parameters for
the same ΔE in both readings; it is the prediction of the contour reading, and of the energy reading
but for a factor that is the same in all cells of one duration.
"""
    for prediction, title in (("quadratic", "Quadratic width"), ("change", "Eq. 15")):
        rows = [
            [
                group["reading"],
                _milliseconds(group["T"]),
                group["parameter"],
                _interval(group["correlation"]),
                _interval(group["slope"]),
                number(group["ratio"]),
                _interval(group["within_tenth"], percent),
                _interval(group["within_twice"], percent),
            ]
            for group in record["tracking"]
            if group["prediction"] == prediction and "slope" in group
        ]
        heads = ["Noise", "T", "", "correlation", "slope", "ratio", "within 10 %", "within 2 x"]
        text += f"\n{title}:\n\n{table(heads, rows)}\n"
    return text + _drawn(record, "tracking")


def _interval(found: Record | None, shown: Callable[[float], str] = "{:.2f}".format) -> str:
    if found is None:
        return "–"
    return f"{shown(found['value'])} ({shown(found['low'])} to {shown(found['high'])})"


def _conventions(record: Record) -> str:
    rows = []
    for group in record["tolerances"]:
        shares = [percent(w["share"]) for w in group["within"]]
        rows.append([group["reading"], _milliseconds(group["T"]), *shares])
    heads = [f"{100 * w['tolerance']:g} %" for w in record["tolerances"][0]["within"]]
    text = f"""\
## How much hangs on the tolerance

Share of cells in which none of the three widths is off by more than a tolerance, the ends of
intervals not asked for:

{table(["Noise", "T", *heads], rows)}
"""
    return text + _drawn(record, "tolerance")


def _drawn(record: Record, kind: str) -> str:
    """The figures of a kind, each with its caption below."""
    return "".join(
        f"\n![{figure['caption']}]({figure['file']})\n\n*{figure['caption']}*\n"
        for figure in record["figures"]
        if figure["kind"] == kind
    )


def _verdicts(record: Record) -> str:
    criteria = record["criteria"]
    present = [v for v in VERDICTS if any(v in group["counts"] for group in record["verdicts"])]
    rows = [
        [
            group["reading"],
            _milliseconds(group["T"]),
            *(f"{group['counts'].get(v, 0)} of {group['of']}" for v in present),
            f"{group['width_alone']} of {group['of']}",
        ]
        for group in record["verdicts"]
    ]
    text = f"""\
## Where the ellipse holds

The quadratic width of a parameter *agrees* if the posterior's standard deviation lies within
{percent(criteria["width_tolerance"])} of it and both ends of the 95 % interval lie within
{criteria["end_tolerance"]:g} widths of where a Gaussian's would. A cell's verdict is the worst of
its three parameters'. The last column counts cells in which the standard deviations alone are
right, wherever the intervals lie.

{table(["Noise", "T", *present, "sd alone"], rows)}

{_glossary(present, criteria)}

Cells that agree, along each axis of the grid:
"""
    for axis, title in _AXES.items():
        groups = record["along"][axis]
        values = list(dict.fromkeys(group[axis] for group in groups))
        if len(values) < 2:
            continue
        rows = []
        for reading in dict.fromkeys(group["reading"] for group in groups):
            found = {g[axis]: g for g in groups if g["reading"] == reading}
            cells = [
                f"{found[v]['counts'].get('agrees', 0)} of {found[v]['of']}" if v in found else "–"
                for v in values
            ]
            rows.append([reading, *cells])
        heads = [words(v) if isinstance(v, str) else f"{v:g}" for v in values]
        text += f"\n{title}:\n\n{table(['Noise', *heads], rows)}\n"
    return text


def _glossary(present: Sequence[str], criteria: Record) -> str:
    meanings = {
        "curved": "the error is no parabola over the width of the posterior",
        "heavy-tailed": "extreme values are likelier than the ellipse says (the 95 % interval is "
        f"more than {criteria['heavy_tail']:g} times the 68 % one; a Gaussian's is "
        f"{NORMAL_95:g} times)",
        "truncated": "a parameter's physical bound lies within reach of the data, and cuts the "
        "ellipse off",
        "non-identifiable": "the data do not bound the parameter on at least one side",
        "not converged": "the sampler did not converge, so there is nothing to compare with",
    }
    return "\n".join(f"- *{v}*: {meanings[v]}." for v in present if v in meanings)


def _ratios(record: Record) -> str:
    rows = []
    for group in record["ratios"]:
        if not group["finite"]:
            continue
        rows.append(
            [
                group["reading"],
                _milliseconds(group["T"]),
                group["parameter"],
                *(number(group[q]) for q in ("q5", "q50", "q95")),
                f"{group['of'] - group['finite']} of {group['of']}",
            ]
        )
    return f"""\
## By how much it is wrong

Posterior standard deviation divided by the quadratic width: below 1 the ellipse is too wide,
above 1 too narrow. The last column counts cells in which the Hessian gives no width at all.

{table(["Noise", "T", "", "5 %", "median", "95 %", "no width"], rows)}"""


def _why(record: Record) -> str:
    causes = [
        [
            group["reading"],
            group["verdict"],
            str(group["of"]),
            _median(group["shift"]),
            _median(group["distance"]),
            _median(group["bend"]),
            _median(group["E"]),
        ]
        for group in record["causes"]
    ]
    text = f"""\
## Why it fails

How wrong the ellipse is, is measured in every cell by *shift*: the largest distance, in quadratic
widths, of an end of a 95 % posterior interval from where a Gaussian's would be. Three things may
explain it. *Distance*: how many quadratic widths the optimum lies from the nearest lower bound;
below about 2 the ellipse reaches impossible values. *Bend*: the ratio, either way up, of the
widths from the full Hessian and from the slopes alone (Gauss-Newton); it is 1 where KBI fits
exactly or is linear in its parameters. *E\\**: the error at the optimum, what KBI cannot describe
of the response. Medians:

{table(["Noise", "Verdict", "Cells", "Shift", "Distance", "Bend", "E*"], causes)}

Share of cells that agree, by distance:

{table(*_distance_table(record))}
"""
    for group in record["bounds"]:
        if group["of"]:
            ends = ", ".join(f"{bound} in {n}" for bound, n in group["counts"].items())
            text += (
                f"\n{group['reading'].capitalize()}: {_cells(group['of'])} truncated. A bound ends "
                f"a 95 % profile interval: {ends or 'none'} (in one cell there may be several).\n"
            )
    rows = [
        [
            group["reading"],
            f"at least {group['least_distance']:g}" if group["least_distance"] else "all",
            str(group["E"]["of"]),
            *(_signed(group[k]["spearman"]) for k in ("nearness", "bend", "E")),
        ]
        for group in record["associations"]
    ]
    text += f"""
How closely does each go with the shift? Rank correlations, 1 if the one always rises with the
other; nearness is distance with its sign turned. Over all cells the bounds may hide what else
matters, so that cells away from them are also given alone:

{table(["Noise", "Distance", "Cells", "Nearness to a bound", "Bend", "E*"], rows)}"""
    errors = [group["E"]["spearman"] for group in record["associations"]]
    if all(value is not None and value < 0 for value in errors):
        text += """

E* goes the other way: the better KBI fits, the worse the ellipse. A response that is easily fitted
is one that says little about K, B and I, so a small error is no sign of a trustworthy width."""
    return text


def _distance_table(record: Record) -> tuple[list[str], list[list[str]]]:
    classes = record["distances"][0]["classes"]
    heads = [
        f"{c['from']:g} to {c['to']:g}" if c["to"] is not None else f"{c['from']:g} and more"
        for c in classes
    ]
    rows = [
        [
            group["reading"],
            *(f"{c['agrees']} of {c['of']}" if c["of"] else "–" for c in group["classes"]),
        ]
        for group in record["distances"]
    ]
    return ["Noise", *heads], rows


def _structural(record: Record) -> str:
    names = {
        "slow": "slow: K_CE K_SE / (K_CE + K_SE)",
        "fast": "fast: K_SE",
        "K_CE": "the muscle's: K_CE",
    }
    rows = [
        [
            group["reading"],
            _milliseconds(group["T"]),
            title,
            _percent_signed(group[name]["q50"]),
            f"{_percent_signed(group[name]['q5'])} to {_percent_signed(group[name]['q95'])}",
            f"{group[name]['sds']:.1f}",
            percent(group[name]["beyond_two_sd"]),
        ]
        for group in record["structural"]
        for name, title in names.items()
    ]
    heads = ["Noise", "T", "stiffness", "median", "5 to 95 %", "in sd", "beyond 2 sd"]
    return f"""\
## What no width says

That the ellipse is right about the width does not make K the stiffness of the joint. How far the
fitted K lies from each stiffness that the joint has, as a share of it and in posterior standard
deviations (medians), and in how many cells by more than two of them:

{table(heads, rows)}"""


def _claims(record: Record) -> str:
    rows, means = [], []
    for group in record["relative"]:
        if group["reading"] != "contour":
            continue
        if all("change" in group[name] for name in ("K", "B")):
            means.append(
                [group[n][key]["mean"] for key in ("change", "posterior") for n in ("K", "B")]
            )
        cells = [
            f"{percent(group[name][key]['mean'])} (± {percent(group[name][key]['sd'])})"
            if key in group[name]
            else "–"
            for name in ("K", "B")
            for key in ("change", "posterior")
        ]
        rows.append([_milliseconds(group["T"]), *cells])
    if not rows:
        return ""
    heads = ["T", "K, Eq. 15", "K, posterior", "B, Eq. 15", "B, posterior"]
    said = ""
    if means and all(p < c for *c_, pK, pB in means for c, p in zip(c_, (pK, pB), strict=True)):
        said = """They are sensitive, but less than Eq. 15 says: values that no joint has take a
part of the ellipse, most of it in short windows, and what is left is as wide as the bounds allow,
which is not what was measured."""
    if len(means) > 1 and all(b < a for m, n in pairwise(means) for a, b in zip(m, n, strict=True)):
        said += """

*The longer the window, the smaller the sensitivity.* So it is, by either measure."""
    return f"""\
## What it says of the paper's claims

*K and B are hugely sensitive to measurement error.* Mean (± standard deviation over the cells) of
the change of Eq. 15 as a share of the optimum, and of the posterior's standard deviation as a share
of its mean, in the contour reading, cells with the optimum on its bound left out:

{table(heads, rows)}

{said}

*K and B match no property of the joint.* The section before this one says by how much, and that
the widths do not hold it: with less noise K is more sharply wrong."""


def _trust(record: Record) -> str:
    sampler, referee, limits = record["sampler"], record["referee"], record["criteria"]
    steps = _listed(f"{step} in {n}" for step, n in sampler["steps"].items())
    failing = sampler["not_converged"]
    text = f"""\
## Whether the sampled widths can be trusted

Each posterior was sampled by emcee in four independent ensembles, with the first of three
proposals that works (*laplace-t*: t densities with the shape of the ellipse at every optimum;
*mixture-t*: such densities fitted to a pilot run; *differential evolution*): {steps} of
{sampler["of"]} cells. The largest R-hat across ensembles is {sampler["rhat_largest"]:.4f} (limit
{limits["rhat_limit"]:g}), the smallest effective sample size {sampler["ess_bulk_smallest"]:.0f} in
the bulk and {sampler["ess_tail_smallest"]:.0f} in the tails (limit {limits["ess_limit"]:g}).
{f"{failing} did not converge." if failing else "All converged."}"""
    if referee["of"]:
        text += f"""

Every standard deviation was also computed without random numbers, by quadrature. Over
{referee["of"]} of them the difference, in units of its Monte Carlo error, has a root mean square of
{referee["rms"]:.2f} (1 is expected) and is at most {referee["largest"]:.1f} (the largest of so many
random numbers would come to about {referee["expected_largest"]:.1f}); in relative terms it is at
most {percent(referee["largest_relative"])}."""
        disagreeing = referee["disagreeing"]
        if disagreeing:
            rows = [
                [
                    _place(cell),
                    cell["verdict"],
                    cell["parameter"],
                    number(cell["sampled"]),
                    number(cell["integrated"]),
                ]
                for cell in disagreeing[:MOST_LISTED]
            ]
            text += f"""

More than {referee["limit"]:g} Monte Carlo errors are no chance. This is so in
{_cells(len(disagreeing))}. One of the two methods has missed a part of the posterior there, such as
a second, separate optimum, and the verdict is not to be relied on:

{table(["Cell", "Verdict", "", "sampled sd", "integrated sd"], rows)}"""
    return text


def _failed(record: Record) -> str:
    failed = record["cells"]["failed"]
    if not failed:
        return ""
    rows = [
        [_place(cell), cell["status"], cell["cause"].replace("|", "\\|")]
        for cell in failed[:MOST_LISTED]
    ]
    more = len(failed) - len(rows)
    rest = f" Of {len(failed)} the first {len(rows)}; all are in `atlas.json`:" if more else ""
    return f"""\
## Cells without a result

The same command tries them again.{rest}

{table(["Cell", "Status", "Cause"], rows)}"""


def _posteriors(record: Record) -> str:
    text = "## Posteriors\n" if record["corners"] else ""
    for corner in record["corners"]:
        text += (
            f"\n{corner['caption']}: {corner['verdict']}; {corner['reason']}.\n\n"
            f"![{corner['caption']}]({corner['file']})\n"
        )
    return text


def _maps(record: Record) -> str:
    maps = [figure for figure in record["figures"] if figure["kind"] == "map"]
    text = "## Maps\n" if maps else ""
    for figure in maps:
        text += f"\n{figure['caption']}\n\n![{figure['caption']}]({figure['file']})\n"
    return text


def _again(record: Record) -> str:
    seconds = record["cells"]["seconds"]
    cost = ""
    if seconds["finite"]:
        hours = seconds["q50"] * 1e6 / 3600
        cost = (
            f" A cell takes {number(seconds['q50'], 2)} s of one processor (median), a million of "
            f"them {hours:.0f} hours, shared by all that [work](../docs/cluster.md)."
        )
    return f"""\
## Again

    {record["command"]}

With {made_by(record)}, seed {record["plan"]["seed"]}.{cost} The same command, typed again after
an interruption, goes on where it was; numbers for all cells are in `atlas.nc`
(`xarray.open_dataset("atlas.nc")`), those of this page in `atlas.json`. The command writes every
figure as PDF too."""


def _filled(section: str) -> str:
    """Paragraphs filled to the width of the page; tables, lists, headings and code as they are."""
    parts = section.split("\n\n")
    return "\n\n".join(
        part
        if part.strip().startswith(("|", "- ", "#", "!", "    ")) or part.startswith("    ")
        else textwrap.fill(
            " ".join(part.split()), 100, break_long_words=False, break_on_hyphens=False
        )
        for part in parts
    )


def _median(quantiles: Record) -> str:
    return number(quantiles["q50"]) if quantiles["finite"] else "–"


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.2f}".replace("-", "−")


def _percent_signed(fraction: float) -> str:
    return f"{100 * fraction:+.1f} %".replace("-", "−")


def _cells(n: int) -> str:
    return {0: "no cell", 1: "1 cell"}.get(n, f"{n} cells")


def _milliseconds(T: float) -> str:
    return f"{1000 * T:g} ms"


def _range(values: Sequence[float], unit: str) -> str:
    if len(values) == 1:
        return f"{values[0]:g} {unit}"
    return f"from {values[0]:g} to {values[-1]:g} {unit} in {len(values)} steps"


def _listed(words: Iterable[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def _place(cell: Record) -> str:
    return (
        f"K_CE {cell['K_CE']:g}, B_CE {cell['B_CE']:g}, K_SE/K_CE {cell['ratio']:g}, "
        f"{_milliseconds(cell['T'])}, {words(cell['perturbation'])}, {cell['reading']}"
    )
