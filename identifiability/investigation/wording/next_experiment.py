"""The next experiment in words."""

from __future__ import annotations

from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.wording.verdict import plain
from identifiability.numerals import number


def next_experiment_sentence(following: NextExperiment) -> str:
    """Which perturbation to use, and what it would bring."""
    first, second = map(plain, following.pair)
    best, needed = following.best, following.needed
    if following.resolved:
        return (
            f"To tell {first} from {second}: {best.perturbation}. One trial should do: its "
            f"expected evidence is {number(best.expected_evidence, 2)}, and {number(needed, 2)} "
            "is enough."
        )
    if not following.proposed:
        limits = following.limits
        return (
            f"No perturbation of {number(limits.torque, 2)} Nm, {number(limits.angle, 2)} rad and "
            f"{number(limits.duration, 2)} s at most, which the trials kept to, tells {first} from "
            f"{second}."
        )
    return (
        f"No single perturbation within the limits tells {first} from {second}; the best is "
        f"{best.perturbation}: about {following.repetitions} repetitions would do (expected "
        f"evidence {number(best.expected_evidence, 2)} a trial, {number(needed, 2)} is enough)."
    )
