"""Reasons of a verdict, as data: what kind of reason, about which effects, with which numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

ReasonKind = Literal[
    "errors",
    "removes in turn",
    "richer form not needed",
    "next best",
    "objection",
    "doubt",
    "more parameters",
    "same form",
    "only prediction worse",
    "equations hide",
    "clue",
    "edge of bounds",
    "equations not exact",
    "form of no sensor",
    "only a part",
    "description",
    "probable",
    "not probable enough",
    "nearest form",
    "whatever else",
]


@dataclass(frozen=True)
class Reason:
    """One reason of a verdict.

    Attributes
    ----------
    kind : ReasonKind
        What is said:

        - errors: E ``before`` and ``after`` on the fitted, ``held_out_before`` and
          ``held_out_after`` on the held-out trials, ``floor`` of the noise;
        - removes in turn: the effects, each with the ``share`` of the misfit that it removes;
        - richer form not needed: the first effect, richer than the second, does no better;
        - next best: in the place of the second effect, the first is worse by ``evidence``;
        - objection: what the values of the first effect (in the place of the second, if there is
          one) have against them, whatever the ``evidence``; doubt: the same, of what more likely
          stands for another;
        - more parameters: the first effect leaves less than the second, but not than an error of
          measurement may;
        - same form: no torque and angle tell the effects apart;
        - only prediction worse: the others in the place of the first predict the held-out trials
          worse, but fit them as well;
        - equations hide: the others in the place of the first leave a little more, no more than
          a share ``form`` of what it removes;
        - clue: with the effect too, at its own values, E would fall to ``error`` (``held_out``),
          but it was refused for ``remark``;
        - edge of bounds: a parameter, ``remark``, lies at its bound at ``value``;
        - probable: the effects are there with this ``probability``; that ``nothing`` is missing, or
          something ``unknown``, has these;
        - not probable enough: the same of what is claimed, ``remark``, and of the most probable
          sets by their keys joined by "+": no effect is probable enough to be named;
        - whatever else: effects that are there beside something unknown, each with its probability
          whatever else is;
        - nearest form: the description of no mechanism that something unknown is most like;
        - equations not exact: the named effects leave more than noise;
        - form of no sensor: the effects of the measurement do not fit it;
        - only a part: effects that remove only a part may stand for something else;
        - description: with the first in the place of the others, E is ``error`` (``held_out``).
    effects : tuple of str
    numbers : mapping of str to float
    remark : str
        An effect's own objection or doubt, a refusal, or a parameter's name.
    """

    kind: ReasonKind
    effects: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""
