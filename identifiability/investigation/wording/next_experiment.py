"""The next experiment in words."""

from __future__ import annotations

from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.wording.verdict import plain

_MANY = 200  # repetitions, more than anyone does


def next_experiment_sentence(following: NextExperiment) -> str:
    """Which perturbation to use, and what it would bring."""
    first, second = map(plain, following.pair)
    best, needed = following.best, following.needed
    if following.resolved:
        return (
            f"To tell {first} from {second}: {best.perturbation} (expected evidence "
            f"{best.expected_evidence:.0f} a trial, {needed:.0f} is enough)."
        )
    if following.repetitions > _MANY:
        limits = following.limits
        return (
            f"No perturbation of {limits.torque:.2g} Nm, {limits.angle:.2g} rad and "
            f"{limits.duration:.2g} s at most, which the trials kept to, tells {first} from "
            f"{second}."
        )
    return (
        f"No single perturbation within the limits tells {first} from {second}; the best is "
        f"{best.perturbation}, with an expected evidence of {best.expected_evidence:.1f} a trial: "
        f"about {following.repetitions} repetitions would do."
    )
