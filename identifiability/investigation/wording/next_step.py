"""What to do next, whatever the verdict."""

from __future__ import annotations

from identifiability.investigation.findings import Findings
from identifiability.investigation.wording.next_experiment import next_experiment_sentence
from identifiability.investigation.wording.verdict import listed
from identifiability.numerals import number

_STEPS = {
    "explained": (
        "No experiment is needed to tell effects apart: quote K, B and I of the model with what is "
        "missing, and see whether other records of this joint miss the same."
    ),
    "one_of": (
        "No perturbation within the limits was found that tells them apart: measure one of them by "
        "itself."
    ),
    "measurement": (
        "Record a known inertia alone with the same instruments, mend or model what they do, and "
        "then measure the joint again."
    ),
    "unknown_static": (
        "Look where in the map of the missing torque it is large, and measure there: slowly, so "
        "that inertia is silent, and further out. Its form can be tried as an effect of your own."
    ),
    "unknown_memory": (
        "Repeat one perturbation after different movements, holds and pauses: what the joint "
        "remembers shows where only the past differs. Its form can be tried as an effect of your "
        "own."
    ),
    "unrepeatable": (
        "Repeat one perturbation many times without changing anything: if the responses differ, "
        "control what changes (activity, fatigue, fixation) before fitting any model."
    ),
    "nothing_missing": (
        "Quote K, B and I. What is smaller than the smallest effects named below would show only "
        "with larger perturbations, less noise or more trials."
    ),
    "undecided": "Mend what is said above, or record more trials, and investigate again.",
}


def next_step_sentence(findings: Findings) -> str:
    """The next experiment where one was found, or else what is best done."""
    following = findings.next_experiment
    if following is not None:
        return next_experiment_sentence(following)
    clues = findings.verdict.clues
    if findings.verdict.kind == "explained" and clues:
        instead = findings.verdict.instead_of_clue
        titles = [findings.library[key].title for key in (*clues, *instead)]
        likely = listed(titles, "or" if instead else "and")
        return (
            "Record more trials, some larger and some slower: they tell whether it misses "
            f"{likely} as well. Until then quote K, B and I of the model with all of that, and say "
            "so."
        )
    return _STEPS[findings.verdict.kind]


def safety_sentence(findings: Findings) -> str:
    """What a proposed perturbation keeps to, and what else must be; empty where none is."""
    following = findings.next_experiment
    if following is None or not following.proposed:
        return ""
    limits = following.limits
    return (
        f"It keeps to {number(limits.torque, 2)} Nm, {number(limits.angle, 2)} rad and "
        f"{number(limits.duration, 2)} s at most. Peaks are predicted by models that may be wrong: "
        "begin at a tenth of the size, with mechanical stops and a release within reach."
    )
