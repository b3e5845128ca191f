"""Several records of one joint, in words."""

from __future__ import annotations

from identifiability.investigation.across.agreement import Across, SharedParameter
from identifiability.joint.parameters import plus_minus, with_unit


def across_sentences(found: Across) -> tuple[str, ...]:
    """Whether the records are of one joint, and what differs if they are not."""
    n = len(found.records)
    shared = [one for one in found.parameters if one.shared and one.n > 1]
    if not shared:
        said = ["No parameter that should be the same is told by more than one record."]
    elif found.differing:
        names = ", ".join(_differs(one) for one in found.differing)
        said = [f"The {n} records differ in what should be the same: {names}."]
    elif found.p < 0.01:
        said = [
            f"In no parameter alone do the {n} records differ by more than their widths, but in "
            f"all together they do (p = {found.p:.2g})."
        ]
    else:
        said = [
            f"The {n} records agree in what should be the same "
            f"({', '.join(one.name.replace('_', ' ') for one in shared)}; p = {found.p:.2g})."
        ]
    silent = [record.name for record in found.records if record.log_evidence <= 0]
    if silent and found.model.effect_keys:
        said.append(
            f"In {', '.join(silent)} the effects bring nothing: K, B and I alone are as probable."
        )
    said += [f"{name} could not be fitted: {why}." for name, why in found.failures.items()]
    return tuple(said)


def _differs(one: SharedParameter) -> str:
    value = with_unit(plus_minus(one.value, one.sd), one.unit)
    return f"{one.name.replace('_', ' ')} ({value} together, scatter {100 * one.spread:.2g} %)"
