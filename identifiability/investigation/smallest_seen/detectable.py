"""The smallest effect that would have been seen, for every effect of the library.

What the size must be for the effect to be claimed is found by halving a bracket in the noise as it
was recorded, and then in the median of several draws of that noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.rules import Rules
from identifiability.investigation.smallest_seen.hidden import Hidden, Known
from identifiability.joint.effects.base import Effect
from identifiability.joint.programs import THREADS
from identifiability.numerals import number
from identifiability.progress import Progress, silent

_FIRST = 0.01  # share of the nominal size that the bracket is looked for from
_STRIDE, _LEAST_STRIDE = 8.0, 1.2  # largest and smallest step of that
_ABOUT = 1.6  # ratio of the bracket's ends
_USUAL = 14.0  # nats of likelihood that a claim takes
_FURTHEST = 1e3  # from the first strength, that theirs may lead
_FOLLOWED = 4  # of the draws, that are nearest to the median
_TURNS, _NEAR = 5, 0.5  # strengths at which they are made at most, and nats that are near enough
_FARTHEST = 0.7  # logarithm of a step's ratio
# To be seen in nine of ten draws at the size, and at a third of it in one: whatever the spread of
# the sizes at which draws show it, as long as it is the same both ways, the middle of what does
# both is this times their median.
_MARGIN = np.sqrt(3.0)
_MOST = 12  # sizes that are tried
_LEAST_SLOPE = 5.0  # of evidence [nats] by the logarithm of size; less is chance
_SMALLEST = 1e-6  # share of the nominal size that is none


@dataclass(frozen=True)
class Detectable:
    """Smallest size of an effect that would have been claimed.

    Attributes
    ----------
    key : str
    parameter : str
        Parameter that measures its size.
    size : float
        In the parameter's unit; where the effect vanishes with infinite stiffness, the largest
        stiffness that would have been seen.
    unit : str
    sentence : str
    values : mapping of str to float
        All parameters of the model with the effect at that size.
    """

    key: str
    parameter: str
    size: float
    unit: str
    sentence: str
    values: Mapping[str, float] = field(default_factory=dict)


def detectable(
    evaluator: Evaluator,
    without: Evaluated,
    library: Mapping[str, type[Effect]],
    rules: Rules,
    *,
    seed: int,
    progress: Progress = silent,
) -> tuple[Detectable, ...]:
    """Smallest effects that would have been seen beside a model that was weighed.

    An effect counts as seen where its probability rises from one among all effects of the library
    and the unknown to ``rules.claimed``. At the stated size it is in nine of ten draws of the noise
    or more, and at a third of it in one or less: that is the square root of three times the size at
    which it is in half of ``rules.noise_draws``, if draws differ by no more than 1.7 times.

    Effects that stay invisible at any size are left out, and those that have no one size: play with
    as stiff a link as there can be would still be a link.

    Parameters
    ----------
    evaluator : Evaluator
    without : Evaluated
        The model in which nothing was found missing.
    library : mapping of str to type of Effect
    rules : Rules
    seed : int
        Of draws of the noise.
    progress : callable
        Told ``(what, done, total)``.
    """
    known = Known.of(evaluator, without, library, rules, seed)
    searches = []
    for key, kind in library.items():
        if not without.model.takes(kind):
            continue
        hidden = Hidden(known, without.model + kind(), key)
        if hidden.has_one_size:
            searches.append(_Search(hidden, rules.noise_draws))
    found: list[Detectable] = []
    with ThreadPoolExecutor(THREADS) as pool:
        for i, one in enumerate(pool.map(_Search.smallest, searches)):
            progress("the smallest effects that would have been seen", i + 1, len(searches))
            if one is not None:
                found.append(one)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for the smallest size of a hidden effect that would be seen.

    Attributes
    ----------
    hidden : Hidden
    draws : int
        Of the noise, in half of which it has to be seen.
    """

    hidden: Hidden
    draws: int

    def smallest(self) -> Detectable | None:
        """Smallest size at which it is seen; ``None`` where it is seen at none."""
        hidden, p = self.hidden, self.hidden.size
        assert p.null is not None
        finite = np.isfinite(p.null)
        nominal = p.nominal - p.null if finite else 1 / p.nominal
        most = p.upper - p.null if finite else 1 / max(p.lower, 1e-9)
        first = self._in_known_noise(_FIRST * nominal)
        about = self._bracketed(min(first, most), _SMALLEST * nominal, most)
        found = None if about is None else self._seen_in_draws(about, most)
        if found is None:
            return None
        values = hidden.values(min(_MARGIN * found, most))
        size = values[hidden.sizes[0]]
        words = f"{p.description} {'of' if finite else 'up to'} {number(size, 2)} {p.unit}"
        return Detectable(hidden.key, hidden.sizes[0], size, p.unit, words, values)

    def _in_known_noise(self, strength: float) -> float:
        """About the strength at which it would be seen if the noise were known, from any other."""
        length = self.hidden.length(strength)
        if length is None:
            return strength
        step = np.sqrt(2 * _USUAL) / max(length, 1e-6)
        return strength * float(np.clip(step, 1 / _FURTHEST, _FURTHEST))

    def _bracketed(self, strength: float, least: float, most: float) -> float | None:
        """About the strength from which on it is seen in the noise as recorded."""
        low, high = 0.0, np.inf
        for _ in range(_MOST):
            found = self.hidden.gained(strength)
            if found is None:  # the response has no bounds: no joint has an effect of that size
                return None
            gain, penalty = found[0]
            if gain >= 0:
                high = strength
            else:
                low = strength
            if low >= most or high < least:
                return None
            if abs(gain) < _NEAR:
                return strength
            if high <= _ABOUT * low:
                return high
            # Evidence grows with the square of the strength, or less where noise can be its colour.
            short_of = np.sqrt(penalty / max(gain + penalty, 1e-2))
            # Further than to where it is thought to be: what lies between two is found quickly.
            ahead = max(abs(np.log(short_of)), np.log(_LEAST_STRIDE))
            strength *= float(np.exp(-np.sign(gain) * min(ahead, np.log(_STRIDE))))
            if low > 0 and np.isfinite(high) and not low * _ABOUT < strength < high / _ABOUT:
                strength = float(np.sqrt(low * high))
            strength = min(max(strength, _ABOUT * low), most)
        return high if np.isfinite(high) else None

    def _seen_in_draws(self, strength: float, most: float) -> float | None:
        """Strength at which it is seen in half of the draws of the noise.

        The draws are the same at every strength. So those that are nearest to the median at the
        first stay so near it, and the others need not be made again.
        """
        draws = np.arange(1, 1 + self.draws)
        before = None
        for _ in range(_TURNS):
            found = self.hidden.gained(strength, draws.tolist())
            if found is None:
                return None
            gains, penalties = np.array(found).T
            left = float(np.median(gains))
            if left < 0 and strength >= most:
                return None
            if abs(left) < _NEAR:
                break
            if before is None:  # evidence grows with the square of the strength
                slope = 2 * float(np.median(penalties))
            else:
                slope = (left - before[1]) / float(np.log(strength / before[0]))
            slope = max(slope, _LEAST_SLOPE)
            before = strength, left
            middle = max(0, gains.size - _FOLLOWED) // 2
            draws = draws[np.argsort(gains, kind="stable")[middle : middle + _FOLLOWED]]
            step = float(np.clip(-left / slope, -_FARTHEST, _FARTHEST))
            strength = min(strength * float(np.exp(step)), most)
        return strength
