"""The comparison of a model with its trials, in sentences."""

from __future__ import annotations

from identifiability.investigation.fits.refits import NAMES, UNITS
from identifiability.investigation.where.compare import Change, Comparison, Constancy
from identifiability.investigation.where.numerals import probability, told_apart
from identifiability.measurement.perturbations import WINDOWS

_WITH = {
    "window": "with the window",
    "amplitude": "with the size of the perturbation",
    "direction": "with its direction",
    "condition": "with the kind of perturbation",
    "trial": "from trial to trial",
}
_NOT_TESTED = {
    "window": (
        f"Fewer than two of the windows of {1000 * WINDOWS[0]:g} to {1000 * WINDOWS[-1]:g} ms fit "
        "into the trials, so whether K, B and I change with the window is not known."
    ),
    "amplitude": (
        "All perturbations are of one size, so whether K, B and I change with it is not known."
    ),
    "direction": (
        "All perturbations go one way, so whether K, B and I change with the direction is not "
        "known."
    ),
    "condition": "All trials are of one kind, so K, B and I cannot change with it.",
    "trial": "There is one trial, so K, B and I cannot change from trial to trial.",
}
_UNITS = dict(zip(NAMES, UNITS, strict=True))


def comparison_sentences(comparison: Comparison) -> tuple[str, ...]:
    """One sentence an aspect in which K, B and I may change."""
    return tuple(constancy_sentence(constancy) for constancy in comparison.constancy)


def constancy_sentence(found: Constancy) -> str:
    """Whether K, B and I change in one aspect, and how."""
    if not found.groups:
        return _NOT_TESTED[found.by]
    chance = probability(found.p_value)
    if not found.significant:
        return (
            f"K, B and I do not change {_WITH[found.by]} by more than their errors explain "
            f"({chance})."
        )
    *others, last = [_change(c, found.by) for c in found.changes if c.notable] or [""]
    if not last:
        return f"K, B and I change {_WITH[found.by]} ({chance}), though none by itself."
    listed = f"{', '.join(others)} and {last}" if others else last
    longest, shortest = found.groups[-1].label, found.groups[0].label
    how = {
        "window": f"as the window shortens from {longest} to {shortest}",
        "amplitude": "from small to large perturbations",
        "direction": "from the positive to the negative direction",
    }.get(found.by, _WITH[found.by])
    remark = "; the waveforms differ too" if found.mixed else ""
    return f"{listed} {how}: it should not if the model is right{remark}."


def _change(change: Change, by: str) -> str:
    before, after = told_apart(change.before, change.after)
    name, unit = change.parameter, _UNITS[change.parameter]
    if by in ("condition", "trial"):
        return f"{name} goes from {before} ({change.first}) to {after} {unit} ({change.second})"
    verb = "rises" if change.after > change.before else "falls"
    return f"{name} {verb} from {before} to {after} {unit}"
