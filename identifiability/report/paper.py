"""The page that puts the published numbers of Kistemaker & Rozendaal (2011) beside ours.

It is made from the record of `study.paper_record` alone. Published numbers, and only those, are
written here by hand.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from identifiability.provenance import made_by
from identifiability.report.markdown import number, percent, table, words

COMMAND = "identifiability paper --out results"

Record = Mapping[str, Any]


class Published(NamedTuple):
    """A statement of the paper and what we find.

    Attributes
    ----------
    what : str
    published : str
        As printed.
    where : str
        Where it stands in the paper.
    ours : function of the record
        Our value, as text.
    outcome : function of the record
        Whether it comes out.
    note : str
        Key of its explanation in `NOTES`, "" where none is needed.
    """

    what: str
    published: str
    where: str
    ours: Callable[[Record], str]
    outcome: Callable[[Record], str]
    note: str = ""


def _panel(record: Record, letter: str) -> Record:
    found: Record = next(p for p in record["figure2"] if p["panel"] == letter)
    return found


def _panel_value(letter: str, name: str, digits: int) -> Callable[[Record], str]:
    return lambda record: number(_panel(record, letter)[name], digits)


def _near(
    published: float, value: Callable[[Record], float], tolerance: float
) -> Callable[[Record], str]:
    """Yes within a relative tolerance, nearly within twenty per cent."""

    def outcome(record: Record) -> str:
        off = abs(value(record) / published - 1)
        return "yes" if off <= tolerance else "nearly" if off <= 0.2 else "**no**"

    return outcome


def _sensitivity(T: str, name: str, mean: float, spread: float) -> Published:
    """Mean and standard deviation of a relative change in a window; numbers in per cent."""
    key = f"d{name}_over_{name}"
    near_mean = _near(mean / 100, lambda record: record["sensitivity"][T][key]["mean"], 0.03)
    near_spread = _near(spread / 100, lambda record: record["sensitivity"][T][key]["sd"], 0.03)

    def ours(record: Record) -> str:
        found = record["sensitivity"][T][key]
        return f"{percent(found['mean'])} (± {percent(found['sd'])})"

    return Published(
        f"mean Δ{name}/{name}, T = {T[1:]} ms",
        f"{mean:g} % (± {spread:g} %)",
        "Results, 'Sensitivity'",
        ours,
        lambda record: f"mean: {near_mean(record)}; ±: {near_spread(record)}",
        "spread",
    )


def _medians(record: Record, T: str, quantity: str) -> dict[str, float]:
    return {key: found[quantity]["median"] for key, found in record["perturbations"][T].items()}


def _spread_over_perturbations(record: Record, quantity: str) -> dict[str, float]:
    """Largest over smallest median of the five perturbations, by window."""
    out = {}
    for T in record["perturbations"]:
        medians = _medians(record, T, quantity).values()
        out[T] = max(medians) / min(medians)
    return out


def _factors(quantity: str) -> Callable[[Record], str]:
    def ours(record: Record) -> str:
        factors = _spread_over_perturbations(record, quantity)
        return "medians differ by a factor of " + ", ".join(
            f"{number(f, 2)} ({T[1:]} ms)" for T, f in factors.items()
        )

    return ours


def _same(quantity: str) -> Callable[[Record], str]:
    """Whether the medians of the perturbations agree to within a quarter in every window."""
    return lambda record: (
        "yes" if max(_spread_over_perturbations(record, quantity).values()) < 1.25 else "**no**"
    )


def _ranges(record: Record, ratio: float) -> list[Record]:
    return [found for found in record["ranges"] if found["ratio"] == ratio]


def _stiffness_range(record: Record, ratio: float) -> tuple[float, float]:
    found = _ranges(record, ratio)
    return (
        min(r["K_over_K_CE_smallest"] for r in found),
        max(r["K_over_K_CE_largest"] for r in found),
    )


def _stiffness_range_text(record: Record) -> str:
    low, high = _stiffness_range(record, 5.0)
    return f"{number(low, 2)} to {number(high, 2)} times"


def _fold_text(record: Record) -> str:
    return ", ".join(
        f"{r['B_fold_change_largest']:.0f}-fold ({1000 * r['T']:.0f} ms)"
        for r in _ranges(record, 5.0)
    )


def _between_text(record: Record) -> str:
    counts = record["approximations"]
    return "; ".join(
        f"{T[1:]} ms: K in {c['K_between']}, B in {c['B_between']} of {c['cells']} cells"
        for T, c in counts.items()
    )


def _errors_text(record: Record) -> str:
    return "median E* " + ", ".join(
        f"{number(e['median'], 2)} ({T[1:]} ms)" for T, e in record["errors"].items()
    )


PUBLISHED = (
    Published(
        "Figure 2A, stiffness K",
        "55 Nm/rad",
        "Results, 'Responses of the MSM and the KBI-model'",
        _panel_value("A", "K", 4),
        _near(55, lambda r: _panel(r, "A")["K"], 0.01),
    ),
    Published(
        "Figure 2A, damping B",
        "0.36 Nms/rad",
        "the same",
        _panel_value("A", "B", 3),
        _near(0.36, lambda r: _panel(r, "A")["B"], 0.015),
    ),
    Published(
        "Figure 2A, error E",
        "practically zero",
        "the same",
        _panel_value("A", "E", 2),
        lambda r: "yes" if _panel(r, "A")["E"] < 1e-5 else "**no**",
    ),
    Published(
        "Figure 2B (sinusoid), stiffness K",
        "88 Nm/rad",
        "the same",
        _panel_value("B", "K", 4),
        _near(88, lambda r: _panel(r, "B")["K"], 0.01),
        "sinusoid",
    ),
    Published(
        "Figure 2D, error E",
        "0.005",
        "the same",
        _panel_value("D", "E", 3),
        _near(0.005, lambda r: _panel(r, "D")["E"], 0.1),
    ),
    Published(
        "Figure 3: matching errors",
        "in general small, especially for smaller time windows",
        "the same",
        _errors_text,
        lambda r: "at 50 ms" if r["errors"]["T200"]["median"] > 0.01 else "yes",
        "errors",
    ),
    Published(
        "Figure 4: K for a fixed K_CE, K_SE = 5 K_CE",
        "from 1 to 6 times K_CE",
        "the same",
        _stiffness_range_text,
        lambda r: "in part",
        "range",
    ),
    Published(
        "Figure 5: B, changing K_CE alone",
        "100-fold",
        "the same",
        _fold_text,
        lambda r: (
            "yes" if max(x["B_fold_change_largest"] for x in _ranges(r, 5.0)) > 100 else "**no**"
        ),
    ),
    Published(
        "Table 1: K and B lie between low- and high-frequency approximation",
        "in general",
        "Results, 'Analytically approximated KBI parameters'",
        _between_text,
        lambda r: (
            "K: yes; B: **no**"
            if r["approximations"]["T50"]["B_between"] < 0.5 * r["approximations"]["T50"]["cells"]
            else "yes"
        ),
        "between",
    ),
    Published(
        "Figure 7A, change of K for ΔE = 0.001",
        "about 200 %",
        "Results, 'Sensitivity'",
        lambda r: percent(_panel(r, "A")["dK"] / _panel(r, "A")["K"]),
        _near(2.0, lambda r: _panel(r, "A")["dK"] / _panel(r, "A")["K"], 0.05),
        "impossible",
    ),
    Published(
        "Figure 7A, change of B for ΔE = 0.001",
        "over 900 %",
        "the same",
        lambda r: percent(abs(_panel(r, "A")["dB"] / _panel(r, "A")["B"])),
        _near(9.0, lambda r: abs(_panel(r, "A")["dB"] / _panel(r, "A")["B"]), 0.05),
        "impossible",
    ),
    _sensitivity("T50", "K", 65, 13),
    _sensitivity("T100", "K", 12, 7),
    _sensitivity("T200", "K", 7, 1),
    _sensitivity("T50", "B", 880, 1350),
    _sensitivity("T100", "B", 65, 99),
    _sensitivity("T200", "B", 4, 2),
    Published(
        "sensitivity of K",
        "did not depend on the type of perturbation",
        "Results, 'Sensitivity'",
        _factors("dK_over_K"),
        _same("dK_over_K"),
        "perturbations",
    ),
    Published(
        "ability of KBI to describe the response",
        "none of the perturbation types was superior",
        "Results, 'Different types of perturbations'",
        _factors("E"),
        _same("E"),
        "perturbations",
    ),
)


def _note_sinusoid(record: Record) -> str:
    valley, B = record["valley"], _panel(record, "B")
    slips = valley["timing_slip"]
    held, free = slips["MSM"], slips["MSM, unbounded"]
    simplex = B["simplex"]
    return f"""\
The optimum is K = {number(B["K"])}, and every method we tried finds it: least squares from four
starts (E* = {number(B["E"], 2)}), and the Nelder-Mead simplex that the paper used, with the default
tolerances of MATLAB's `fminsearch`, started at K = 50, B = 1, I = 0.1
(K = {number(simplex["K"])}, B = {number(simplex["B"])}, E = {number(simplex["E"], 2)}). So a loose
tolerance of the simplex does not by itself explain K = {number(valley["K"], 2)}. What makes such
a value possible is that E is a flat valley along K: at K = {number(valley["K"], 2)}, with B and I
fitted
anew, E is only {number(valley["E_unbounded"], 2)} if B may be negative
(B = {number(valley["B_unbounded"], 2)}), and {number(valley["E"], 2)} if it may not
(B = {number(valley["B"], 2)}). Both lie below the ΔE of {number(record["dE"], 1)} that, the paper
says, changes a response almost unnoticeably. A small difference between the two simulations is
then enough. For example, if the sinusoid is held constant over samples of 1 ms in the
musculoskeletal model, which delays it by half a millisecond, and is continuous in KBI, the best K
is {number(free["K"])} (without bounds;
{number(held["K"])} with B not below zero); the other way round it is {number(slips["KBI"]["K"])}.
Whether this is what happened cannot be told from the text."""


def _note_spread(record: Record) -> str:
    def of(T: str, name: str) -> Record:
        found: Record = record["sensitivity"][T][f"d{name}_over_{name}"]
        return found

    K, B = of("T50", "K"), of("T50", "B")
    printed = {
        ("T50", "K"): 0.13,
        ("T100", "K"): 0.07,
        ("T200", "K"): 0.01,
        ("T50", "B"): 13.5,
        ("T100", "B"): 0.99,
        ("T200", "B"): 0.02,
    }
    half = [abs(of(*key)["sd"] / 2 / value - 1) <= 0.15 for key, value in printed.items()]
    largest = of("T50", "B")["largest_B_of_these"]
    return f"""\
The means come close to the published ones; the standard deviations do not come out. The latter say
little in any case, because the cells are far from normally distributed: at 50 ms
{B["cells_with_half_the_sum"]} of {B["cells"]} cells, all with a fitted B of at most
{number(largest, 2)} Nms/rad, make up half of the sum behind the mean of ΔB/B, and
{K["cells_with_half_the_sum"]} cells half of that of ΔK/K. A relative change is large where the
fitted value is near zero. The median cell changes by {percent(K["median"])} in K and
{percent(B["median"])} in B, where the means are {percent(K["mean"])} and {percent(B["mean"])}. Half
of our standard deviation lies within 15 % of the printed one in {sum(half)} of the {len(half)}
cases; we know of no reason to halve it, so this may be chance."""


def _note_errors(record: Record) -> str:
    errors = record["errors"]
    return f"""\
At 50 ms E* is small everywhere (largest {number(errors["T50"]["largest"], 2)}). At 100 and 200 ms a
quarter of the cells lie above {number(errors["T100"]["q75"], 2)} and
{number(errors["T200"]["q75"], 2)}, the largest at {number(errors["T100"]["largest"], 2)} and
{number(errors["T200"]["largest"], 2)}: there KBI does not describe the response, and no
experimenter would call the fit good."""


def _note_range(record: Record) -> str:
    low, high = _stiffness_range(record, 5.0)
    # Two springs in series with K_SE = 5 K_CE have 5/6 of K_CE.
    series = 5.0 / 6.0
    text = f"""\
With K_SE = 5 K_CE the approximations of Table 1 run from 5/6 to 5 times K_CE, and all our fits lie
between them. The published range would fit K in units of the slow limit K_LF: there ours runs from
{number(low / series, 2)} to {number(high / series, 2)}."""
    if 10.0 in record["grid"]["ratio"]:
        low, high = _stiffness_range(record, 10.0)
        text += f"""
With K_SE = 10 K_CE it runs from {number(low, 2)} to {number(high, 2)} times K_CE."""
    return text


def _note_between(record: Record) -> str:
    A = _panel(record, "A")
    s = A["setting"]
    share = s["K_SE"] / (s["K_CE"] + s["K_SE"])
    low, high = s["B_CE"] * share**2, s["I"] * s["K_SE"] / s["B_CE"]
    counts = record["approximations"]["T50"]
    return f"""\
The fitted stiffness lies between its two approximations in {counts["K_between"]} of
{counts["cells"]} cells at 50 ms, the damping in {counts["B_between"]}; in {counts["B_below"]} it
is smaller than both. In Figure 2A, for example, B_LF = {number(low)} and B_HF = {number(high)}, but
the fit is B = {number(A["B"])}. Muscle and tendon together show a damping of
B_CE K_SE²/((K_CE + K_SE)² + B_CE²ω²) to a sinusoid of frequency ω, which falls to zero as ω rises.
B_HF is what this becomes at ω = √(K_SE/I) if B_CE ω is much larger than K_CE + K_SE; a short window
weighs faster changes than that."""


def _note_impossible(record: Record) -> str:
    A = _panel(record, "A")
    return f"""\
Of the same size, but not the same. More important, the changed joint is an impossible one: K, B =
{number(A["K"] + A["dK"])}, {number(A["B"] + A["dB"])} or {number(A["K"] - A["dK"])},
{number(A["B"] - A["dB"])}, negative damping or negative stiffness. Where the quadratic reaches that
far it is no longer exact either: the two have E of {number(A["E_plus"], 2)} and
{number(A["E_minus"], 2)} instead of {number(A["E"] + record["dE"], 1)}. What can be said about K
and B when impossible values are excluded is the subject of the atlas of this package."""


def _note_perturbations(record: Record) -> str:
    short = _medians(record, "T50", "dK_over_K")
    least, most = min(short, key=short.__getitem__), max(short, key=short.__getitem__)
    errors = _medians(record, "T50", "E")
    low, high = min(errors, key=errors.__getitem__), max(errors, key=errors.__getitem__)
    return f"""\
At 50 ms the median ΔK/K runs from {percent(short[least])} ({words(least)}) to
{percent(short[most])} ({words(most)}), and the median E* from {number(errors[low], 2)}
({words(low)}) to {number(errors[high], 2)} ({words(high)}). The two go together: the perturbation
that KBI follows best is the one that says least about K. At 200 ms the perturbations differ
little in ΔK/K. The paper does not give the duration of its pulses; ours take 10 ms, and the second
of a double pulse follows at once with the opposite sign."""


NOTES: dict[str, tuple[str, Callable[[Record], str]]] = {
    "sinusoid": ("The sinusoid's K", _note_sinusoid),
    "errors": ("Small errors", _note_errors),
    "range": ("One to six times", _note_range),
    "between": ("Between the approximations", _note_between),
    "impossible": ("Figure 7A", _note_impossible),
    "spread": ("Means, standard deviations, medians", _note_spread),
    "perturbations": ("Perturbations", _note_perturbations),
}


def page(record: Record) -> str:
    """Markdown page of the study.

    Parameters
    ----------
    record : mapping
        From `paper_record.record`, or read from its JSON file.

    Returns
    -------
    str
        It embeds the figures by their paths relative to the record.
    """
    parts = [
        _introduction(record),
        _published(record),
        _examples(record),
        _grids(record),
        _approximations(record),
        _sensitivities(record),
        _perturbations(record),
        _conditions(record),
    ]
    return _reflow("\n\n".join(parts))


def _reflow(markdown: str) -> str:
    """Break paragraphs and list items into lines anew, numbers having been put in."""
    blocks = []
    for block in re.split(r"\n{2,}", markdown.strip()):
        if block[0] in "#|!`":
            blocks.append(block)
            continue
        items = []
        for item in re.split(r"\n(?=- )", block):
            mark = re.match(r"- |\d+\. ", item)
            items.append(
                textwrap.fill(
                    " ".join(item.split()),
                    100,
                    subsequent_indent=" " * len(mark[0]) if mark else "",
                    break_long_words=False,
                    break_on_hyphens=False,
                )
            )
        blocks.append("\n".join(items))
    return "\n\n".join(blocks) + "\n"


def _figure(name: str, caption: str) -> str:
    return f"![{caption}](paper/{name}.png)\n\n{caption}\n"


def _introduction(record: Record) -> str:
    quick = ""
    if record["quick"]:
        quick = """
**This is a quick run on a coarser grid; its averages differ from those of the full grid.**
"""
    return f"""\
# Kistemaker & Rozendaal (2011), computed again

Kistemaker DA, Rozendaal LA (2011) *In vivo dynamics of the musculoskeletal system cannot be
adequately described using a stiffness-damping-inertia model*, PLoS ONE 6(5): e19568,
[doi:10.1371/journal.pone.0019568](https://doi.org/10.1371/journal.pone.0019568).

The paper takes a joint whose properties are known, a muscle (stiffness K_CE, damping B_CE) that
pulls at a segment (inertia I) through a tendon (stiffness K_SE), perturbs it, and fits stiffness K,
damping B and inertia I to the response as if there were no tendon. This page repeats all of it and
says what comes out, what does not, and why.

It is written, with its numbers and figures, by

```
{COMMAND}
```

({made_by(record)}) from {record["fits"]} fits; the numbers are in `paper.json`, all fits
in `paper.nc`.
{quick}"""


def _published(record: Record) -> str:
    order = list(NOTES)
    rows = []
    for item in PUBLISHED:
        note = f"[{order.index(item.note) + 1}](#notes)" if item.note else ""
        rows.append(
            [
                item.what,
                item.published,
                item.ours(record),
                item.outcome(record),
                note,
                item.where,
            ]
        )
    head = ["", "published", "ours", "comes out?", "note", "where in the paper"]
    notes = "\n\n".join(
        f"{i}. **{title}.** {text(record)}" for i, (title, text) in enumerate(NOTES.values(), 1)
    )
    return f"""\
## Published and computed

The table compares every number that the text of the paper prints, and the general statements that
can be counted. K in Nm/rad, B in Nms/rad.

{table(head, rows)}

### Notes

{notes}
"""


def _examples(record: Record) -> str:
    rows = []
    for p in record["figure2"]:
        s = p["setting"]
        rows.append(
            [
                p["panel"],
                f"{s['K_CE']:g}, {s['B_CE']:g}, {s['K_SE']:g}, {s['I']:g}",
                f"{words(p['perturbation'])}, {1000 * p['T']:.0f} ms",
                *(number(p[name], 4) for name in ("K", "B", "I")),
                number(p["E"], 2),
                *(f"{percent(abs(p['d' + name] / p[name]))}" for name in ("K", "B")),
            ]
        )
    head = ["", "K_CE, B_CE, K_SE, I", "perturbation", "K", "B", "I", "E*", "ΔK/K", "ΔB/B"]
    D = _panel(record, "D")
    published = number(record["valley"]["K"], 2)
    return f"""\
## Four examples (Figures 2 and 7)

{table(head, rows)}

The fitted inertia is not the joint's either: {number(D["I"], 3)} instead of
{number(record["I_MSM"], 3)} kg m² in panel D.

{_figure("figure2", "Figure 2. Responses of the joint and of the fitted KBI model.")}
{_figure("valley", f"The smallest E for every K, panels A and B; dotted: K = {published}.")}
{_figure("figure7", "Figure 7. KBI moved from its optimum by the largest change of Eq. 15.")}
"""


def _grids(record: Record) -> str:
    rows = [
        [f"{T[1:]} ms", *(number(e[q], 2) for q in ("q25", "median", "q75", "largest"))]
        for T, e in record["errors"].items()
    ]
    several = sum(m["cells"] for m in record["several_minima"] if m["perturbation"] == "impulse")
    two_minima = (
        f"In {several} cells of all ratios and windows both are minima of E." if several else ""
    )
    others = ""
    if not record["quick"]:
        others = f"""
{_figure("grids_ratio2", "E*, K and B for K_SE = 2 K_CE.")}
{_figure("grids_ratio10", "E*, K and B for K_SE = 10 K_CE.")}"""
    return f"""\
## Errors and estimates over the grid (Figures 3 to 5)

K_SE = 5 K_CE, impulse. E* by window:

{table(["T", "lower quartile", "median", "upper quartile", "largest"], rows)}

{_figure("figure3", "Figure 3. Smallest error E*.")}
At 200 ms two kinds of fit compete: a slow one, with K near K_LF, and a fast one, with K near
K_HF and less damping. Where one takes over from the other K and B change abruptly, and with them
the sensitivity (Figures 8 and 9). {two_minima}

{_figure("figure4", "Figure 4. Fitted stiffness K, and K in units of its slow limit K_LF.")}
{_figure("figure5", "Figure 5. Fitted damping B, and B in units of its slow limit B_LF.")}
{others}"""


def _approximations(record: Record) -> str:
    labels = ["≤ 10 %", "10-25 %", "25-50 %", "50-100 %", "> 100 %"]
    names = {
        "K": "K from the nearer of K_LF, K_HF",
        "B": "B from the nearer of B_LF, B_HF",
        "K_and_B": "both from the nearer pair",
        "K_to_K_CE": "K from K_CE",
        "B_to_B_CE": "B from B_CE",
    }
    rows = [
        [f"{T[1:]} ms", text, *map(str, counts[name])]
        for name, text in names.items()
        for T, counts in record["approximations"].items()
    ]
    return f"""\
## How far the estimates are from anything physical (Table 1)

Number of cells (K_SE = 5 K_CE, impulse) by the distance of the fitted value:

{table(["T", "distance of", *labels], rows)}

The paper's first conclusion comes out: K and B resemble neither the muscle's own values nor, in
most cells, either approximation.
"""


def _sensitivities(record: Record) -> str:
    rows = []
    for name in ("K", "B"):
        for T in record["sensitivity"]:
            found = record["sensitivity"][T][f"d{name}_over_{name}"]
            wider = record["sensitivity_wider"][T][f"d{name}_over_{name}"]
            rows.append(
                [
                    f"Δ{name}/{name}, {T[1:]} ms",
                    *(percent(found[q]) for q in ("mean", "sd", "q25", "median", "q75")),
                    percent(wider["mean"]),
                ]
            )
    wider_B = record["sensitivity_wider"]["B_CE"]
    grid = record["grid"]["B_CE"]
    head = ["", "mean", "sd", "lower quartile", "median", "upper quartile"]
    head.append(f"mean, B_CE to {wider_B:g}")
    long = record["sensitivity"]["T200"]
    example = record["figure6"]
    return f"""\
## Sensitivity (Figures 6, 8 and 9)

Eq. 15 asks how far K, B and I can move together before E rises by {number(record["dE"], 1)}.
K_SE = 5 K_CE, impulse, {record["sensitivity"]["T50"]["cells"]} cells:

{table(head, rows)}

The caption of Figure 3 lets B_CE end at {grid[-1]:g} Nms/rad, the Methods at {wider_B:g}; the last
column shows that this hardly matters.

Eq. 15 finds the direction in which a vector of K, B and I *in these units* can be changed most. As
K is the largest number, this is nearly always the direction of K, and the ΔB that goes with it need
not be the largest change of B: at 200 ms the mean ΔB/B is {percent(long["dB_over_B"]["mean"])} by
Eq. 15, but B alone can change by {percent(long["largest_dB_over_B"]["mean"])} within the same
rise of E.

{_figure("figure6", "Figure 6. E about one optimum.")}
The paper does not say which setting its Figure 6 shows, only E* = 0.002 (a pure number, not radians
as printed). Ours is the cell of the grid that comes nearest: K_CE = {example["K_CE"]:g}, B_CE =
{example["B_CE"]:g}, K_SE = {example["K_SE"]:g}, T = {1000 * example["T"]:.0f} ms, E* =
{number(example["E"], 3)}. With the inertia held, as when E is computed over K and B alone, the
contour is narrower than Eq. 15 says; with the inertia fitted anew they agree.

{_figure("figure8", "Figure 8. Relative change of K.")}
{_figure("figure9", "Figure 9. Relative change of B.")}
"""


def _perturbations(record: Record) -> str:
    rows = []
    for T, found in record["perturbations"].items():
        for key, c in found.items():

            def text(quantity: str, show: Callable[[float], str], c: Record = c) -> str:
                q25, q50, q75 = (c[quantity][q] for q in ("q25", "median", "q75"))
                return f"{show(q50)} ({show(q25)} - {show(q75)})"

            def short(value: float) -> str:
                return number(value, 2)

            rows.append(
                [
                    f"{T[1:]} ms",
                    words(key),
                    text("E", short),
                    text("K_over_K_LF", short),
                    text("B_over_B_LF", short),
                    text("I_over_I_MSM", short),
                    text("dK_over_K", percent),
                    text("dB_over_B", percent),
                ]
            )
    head = ["T", "perturbation", "E*", "K/K_LF", "B/B_LF", "I/I_MSM", "ΔK/K", "ΔB/B"]
    return f"""\
## Perturbations

Median (quartiles) over the cells with K_SE = 5 K_CE; K_LF and B_LF are the slow limits of Table 1:

{table(head, rows)}

{_figure("perturbations", "Medians and quartiles by perturbation and window.")}
"""


def _conditions(record: Record) -> str:
    bounds = "; ".join(
        f"{b['cells']} cells of the {words(b['perturbation'])} at {1000 * b['T']:.0f} ms "
        f"(K_SE = {b['ratio']:g} K_CE) have {b['parameter']} on a bound"
        for b in record["at_bound"]
    )
    minima = sum(m["cells"] for m in record["several_minima"])
    none = "" if any(b["parameter"] == "B" for b in record["at_bound"]) else " B is never zero."
    return f"""\
## What the paper leaves open, and what was done here

- The integrals in E are taken by Simpson's rule on at least 400 intervals of exact responses, so
  that finer sampling changes nothing. E does not depend on the size of a perturbation.
- Fits: bounded least squares from four starts (the approximations of Table 1 and two between
  them), finished by Newton steps. In {minima} cells not all four end at the same optimum;
  the best is kept.
- Bounds: 0 to 2000 Nm/rad, 0 to 50 Nms/rad, 0.005 to 1 kg m².
  {bounds or "No optimum lies on one"}.{none}
  Cells on a bound are left out of ΔK/K and ΔB/B, as Eq. 15 presumes a minimum without slope.
- The Hessian of E is exact (automatic differentiation), not from finite differences.
- Every average is over the grid: K_CE {record["grid"]["K_CE"][0]:g} to
  {record["grid"]["K_CE"][-1]:g} Nm/rad in {len(record["grid"]["K_CE"])} steps, B_CE
  {record["grid"]["B_CE"][0]:g} to
  {record["grid"]["B_CE"][-1]:g} Nms/rad in {len(record["grid"]["B_CE"])} steps.
"""
