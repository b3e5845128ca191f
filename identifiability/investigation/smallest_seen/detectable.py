"""The smallest effect that would have been seen, for every effect of the library.

What the size must be for the effect to be claimed is found by halving a bracket in the noise as it
was recorded, and with bad luck from draws of that noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from identifiability.errors import InputError
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.rules import Rules
from identifiability.investigation.smallest_seen.hidden import Hidden, Known
from identifiability.joint.effects.base import Effect
from identifiability.joint.programs import THREADS
from identifiability.progress import Progress, silent

_FIRST = 0.01  # share of the nominal size that the bracket is looked for from
_STRIDE = 8.0  # largest step of that
_ABOUT = 1.6  # ratio of the bracket's ends
_USUAL_PENALTY = 8.0  # nats of likelihood that priors take
_FURTHEST = 1e3  # from the first strength, that theirs may lead
_DRAWS, _TURNS = 8, 2  # of the noise, and strengths at which they are made
_APART = 0.02  # logarithm of two strengths' ratio, from which they tell a slope
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
    and the unknown to ``rules.claimed``, in draws of the noise that are less lucky than the median
    by ``rules.bad_luck`` standard deviations. How far draws differ is measured: noise is estimated
    with the model, and a slow trace may be its colour; then evidence grows by the logarithm of its
    size, and not by the square, and varies less. Torques of any form that make up for the trace let
    it vary more.

    Effects that stay invisible at any size are left out.

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
    known = Known.of(evaluator, without, rules.trifle, seed)
    odds = float(np.log(rules.claimed / (1 - rules.claimed) * (len(library) + 1)))
    searches = []
    for key, kind in library.items():
        if key in without.model.effect_keys:
            continue
        try:
            model = without.model + kind()
        except InputError:  # it does not go with an effect that is there
            continue
        searches.append(_Search(Hidden(known, model, key), odds, rules.bad_luck))
    found: list[Detectable] = []
    with ThreadPoolExecutor(THREADS) as pool:
        for i, one in enumerate(pool.map(_Search.smallest, searches)):
            progress("the smallest effects that would have been seen", i + 1, len(searches))
            if one is not None:
                found.append(one)
    return tuple(found)


def unlucky(gains: np.ndarray, penalties: np.ndarray, deviations: float) -> float:
    r"""What is left of evidence [nats] with so many standard deviations of bad luck.

    In known noise twice the log likelihood of a trace is :math:`(\sqrt\lambda + z)^2` with z
    standard normal: the noise lengthens or shortens the trace. Here the scatter of its root is that
    of the draws.

    Parameters
    ----------
    gains, penalties : array, shape (n_draws,)
        Log evidence, and how much of the log likelihood priors took.
    deviations : float
    """
    roots = np.sqrt(2 * np.maximum(gains + penalties, 0.0))
    root = max(float(np.median(roots) - deviations * np.std(roots, ddof=1)), 0.0)
    return 0.5 * root**2 - float(np.median(penalties))


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for the smallest size of a hidden effect that would be seen.

    Attributes
    ----------
    hidden : Hidden
    odds : float
        Log evidence [nats] that its prior asks for.
    bad_luck : float
        Standard deviations.
    """

    hidden: Hidden
    odds: float
    bad_luck: float

    def smallest(self) -> Detectable | None:
        """Smallest size at which it is seen; ``None`` where it is seen at none."""
        hidden, p = self.hidden, self.hidden.size
        assert p.null is not None
        finite = np.isfinite(p.null)
        nominal = p.nominal - p.null if finite else 1 / p.nominal
        most = p.upper - p.null if finite else 1 / max(p.lower, 1e-9)
        first = self._in_known_noise(_FIRST * nominal)
        about = self._bracketed(min(first, most), _SMALLEST * nominal, most)
        found = None if about is None else self._seen_in_draws(*about, most)
        if found is None:
            return None
        values = hidden.values(found)
        size = values[hidden.sizes[0]]
        words = f"{p.description} {'of' if finite else 'up to'} {size:.2g} {p.unit}"
        return Detectable(hidden.key, hidden.sizes[0], size, p.unit, words, values)

    def _in_known_noise(self, strength: float) -> float:
        """About the strength at which it would be seen if the noise were known, from any other."""
        length = self.hidden.length(strength)
        if length is None:
            return strength
        step = np.sqrt(2 * (self.odds + _USUAL_PENALTY)) / max(length, 1e-6)
        return strength * float(np.clip(step, 1 / _FURTHEST, _FURTHEST))

    def _bracketed(self, strength: float, least: float, most: float) -> tuple[float, float] | None:
        """About the strength at which it is as likely seen as not, in the noise as recorded.

        And how much evidence [nats] grows there by the logarithm of the strength.
        """
        low, high = (0.0, 0.0), (np.inf, np.inf)  # strengths and gains
        for _ in range(_MOST):
            found = self.hidden.gained(strength)
            if found is None:  # the response has no bounds: no joint has an effect of that size
                return None
            gain, penalty = found[0]
            if gain >= self.odds:
                high = strength, gain
            else:
                low = strength, gain
            if low[0] >= most or high[0] < least:
                return None
            if high[0] <= _ABOUT * low[0]:
                break
            # Evidence grows with the square of the strength, or less where noise can be its colour.
            short_of = np.sqrt((self.odds + penalty) / max(gain + penalty, 1e-2))
            strength *= float(np.clip(short_of, 1 / _STRIDE, _STRIDE))
            between = low[0] * _ABOUT < strength < high[0] / _ABOUT
            if low[0] > 0 and np.isfinite(high[0]) and not between:
                strength = float(np.sqrt(low[0] * high[0]))
            strength = min(max(strength, _ABOUT * low[0]), most)
        if not np.isfinite(high[0]):
            return None
        slope = (high[1] - low[1]) / np.log(high[0] / low[0]) if low[0] > 0 else 0.0
        return high[0], max(float(slope), _LEAST_SLOPE)

    def _seen_in_draws(self, strength: float, slope: float, most: float) -> float | None:
        """Smallest strength at which it is seen, in the less lucky of draws of the noise."""
        draws = range(1, 1 + _DRAWS)  # the same at every turn: what they add to the gain stays
        before = None
        for _ in range(_TURNS):
            found = self.hidden.gained(strength, draws)
            if found is None:
                return None
            gains, penalties = np.array(found).T
            left = unlucky(gains, penalties, self.bad_luck) - self.odds
            if left < 0 and strength >= most:
                return None
            if before is not None and abs(moved := np.log(strength / before[0])) > _APART:
                slope = max(float((left - before[1]) / moved), slope / 2)
            before = strength, left
            step = float(np.clip(-left / slope, -np.log(_STRIDE), np.log(_STRIDE)))
            strength = min(strength * float(np.exp(step)), most)
        return strength
