"""Reasons of a verdict, as data: what kind of reason, about which effects, with which numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

ReasonKind = Literal[
    "probable",
    "not probable enough",
    "no error",
    "mostly noise",
    "only a part",
    "whatever else",
    "clue",
    "instead of the clue",
    "nearest form",
    "nearest known",
    "errors",
    "chosen alike",
    "chosen with",
    "removes in turn",
    "next best",
    "doubt",
    "same form",
    "equations not exact",
    "edge of bounds",
]


@dataclass(frozen=True)
class Reason:
    """One reason of a verdict.

    Attributes
    ----------
    kind : ReasonKind
        What is said:

        - probable: the effects are there with this ``probability``; that ``nothing`` is missing, or
          something ``unknown``, has these;
        - not probable enough: the same of what is claimed, ``remark``, and of the most probable
          sets by their keys joined by "+": no effect is probable enough to be named;
        - no error: the effects are probable enough, but the errors of their model could not be
          computed, for the reason in ``remark``, so that nothing is named;
        - mostly noise: this ``share`` of the response is noise to the most probable model, so that
          nothing is said about effects;
        - only a part: the effects are probable enough, but leave so much of the misfit of the
          held-out trials that they may stand for something else;
        - whatever else: effects that are there beside something unknown, each with its probability
          whatever else is;
        - clue: the effects that the error is shown to fall with, each with its probability; they
          are not claimed;
        - instead of the clue: what may be in its place, each with its probability: that one of them
          is there is likely, and of no one it is;
        - nearest form: the description of no mechanism that something unknown is most like;
        - nearest known: the effects of the most probable model that has nothing unknown, how many
          nats it is ``behind``, and its E, as of errors;
        - errors: E ``before`` and ``after`` on the fitted, ``held_out_before`` and
          ``held_out_after`` on the held-out trials, ``floor`` of the noise;
        - chosen alike, chosen with: without the held-out trials what is claimed has this
          ``probability``, and would be claimed, or would not;
        - removes in turn: the effects, each with the ``share`` of the misfit that it removes;
        - next best: with the first effect in the place of the second the log evidence is less by
          ``evidence`` [nats], and the set has this ``probability``;
        - doubt: what of the effect's values more likely stands for another;
        - same form: no torque and angle tell the effects apart;
        - equations not exact: the named effects leave a torque of this ``size`` [Nm], or angle
          [rad], which is a ``share`` of the response;
        - edge of bounds: a parameter, ``remark``, lies at its bound at ``value``.
    effects : tuple of str
    numbers : mapping of str to float
    remark : str
        An effect's own doubt, a kind of claim, a parameter's name, or why something failed.
    """

    kind: ReasonKind
    effects: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""
