"""What an investigation adds to prepared trials: which are held out, noise and weights.

Every model is fitted to the same samples with the same weights. A trial weighs by its noise and by
a share of its own energy, so that neither the largest trial nor the quietest decides alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.between import Between, joined
from identifiability.inference.problem import Observation
from identifiability.investigation.pieces import MOST_SAMPLES, pieces, remembering
from identifiability.investigation.rules import Rules
from identifiability.measurement.filtering import Lowpass
from identifiability.measurement.noise import Noise
from identifiability.measurement.prepared import Prepared, prepare
from identifiability.measurement.splitting import Rule, hold_out
from identifiability.measurement.trials import Trial


@dataclass(frozen=True, eq=False)
class Split:
    """The trials that models are fitted to and those they are judged on.

    Attributes
    ----------
    fitted, held_out : tuple of Prepared
    how_held_out : str
        In words, which part was held out.
    held_out_rule : str
        How it was chosen: see `Parts`.
    held_out_numbers : tuple of int
        Of the trials that were, among all; none where it is half of one.
    rules : Rules
        Conventions that everything after goes by.
    """

    fitted: tuple[Prepared, ...]
    held_out: tuple[Prepared, ...]
    how_held_out: str
    held_out_rule: Rule
    held_out_numbers: tuple[int, ...]
    rules: Rules

    @property
    def driven(self) -> str:
        """What was imposed: "torque" or "angle"."""
        return self.fitted[0].trial.driven

    @property
    def has_noise(self) -> bool:
        """Whether every trial has a quiet lead that its noise could be read from."""
        return all(r.lead.n_samples for r in (*self.fitted, *self.held_out))

    def noise_floor(self, part: Sequence[Prepared] | None = None) -> float | None:
        """Error E that the noise alone leaves, pooled over trials; ``None`` where it is unknown.

        Parameters
        ----------
        part : sequence of Prepared, optional
            The fitted trials by default.
        """
        if not self.has_noise:
            return None
        chosen = self.fitted if part is None else part
        return float(np.mean([r.lead.sd**2 / r.mean_square for r in chosen]))

    @property
    def moves_early(self) -> bool:
        """Whether a torque that is not held constant precedes the first onset of some trial."""
        return self.driven == "torque" and any(
            np.ptp(r.trial.torque[: r.lead.n_samples]) > 0 for r in self.fitted if r.lead.n_samples
        )

    def without_leads(self) -> Split:
        """Return the same trials with unknown noise and an unknown level of the response."""
        fitted, held_out = (
            tuple(r.without_lead() for r in part) for part in (self.fitted, self.held_out)
        )
        return replace(self, fitted=fitted, held_out=held_out)

    def floor_uncertainty(self) -> float:
        """Relative standard error of the noise floor, from the lengths of the leads."""
        trials = (*self.fitted, *self.held_out)
        effective = sum(r.lead.n_samples / r.lead.correlation_time for r in trials)
        return float(np.sqrt(2.0 / max(effective, 1.0)))

    def weights_sd(self, part: Sequence[Prepared]) -> np.ndarray:
        """Standard deviation that each trial's residual is measured in, shape (n_trials,)."""
        return np.array(
            [np.sqrt(r.lead.sd**2 + self.rules.discrepancy * r.mean_square) for r in part]
        )

    def observations(self, part: Sequence[Prepared]) -> list[Observation]:
        """Observations of a part, long records cut into pieces that can be computed together."""
        out: list[Observation] = []
        for prepared, sd in zip(part, self.weights_sd(part), strict=True):
            out += pieces(prepared, Noise(float(sd)))
        return out

    @cached_property
    def longest(self) -> int:
        """Samples of the longest observation."""
        every = self.observations(self.fitted) + self.observations(self.held_out)
        return max(o.measured.size for o in every)


def gather(
    trials: Sequence[Trial],
    held_out: Sequence[Trial] = (),
    *,
    lowpass_hz: Lowpass = "auto",
    torque_between: Between = "auto",
    rules: Rules | None = None,
) -> Split:
    """Make trials ready, and choose what to hold out where nothing is named: see `hold_out`.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    held_out : sequence of Trial
        Trials that no model is fitted to.
    lowpass_hz : float, "auto" or None
        Zero-phase low-pass where the angle is imposed: see `cutoff`.
    torque_between : {"auto", "straight", "smooth"}
        How an imposed torque runs between its samples: see `joined`.
    rules : Rules, optional
        Conventions that everything after goes by.

    Returns
    -------
    Split

    Raises
    ------
    InputError
        Where there is no trial, they are driven differently, or one trial moves in one half only.
    """
    if not trials:
        raise InputError("found no trials to fit, expected at least one")
    prepared = joined(prepare([*trials, *held_out], lowpass_hz=lowpass_hz), torque_between)
    parts = hold_out(prepared, len(held_out))
    every = (*parts.fitted, *parts.held_out)
    longest = max(p.last - p.first for p in every)
    n_fitted = len(parts.fitted)
    ready = remembering([_liveliest(p) for p in every])
    parts = replace(parts, fitted=tuple(ready[:n_fitted]), held_out=tuple(ready[n_fitted:]))
    cut = f"; of each part its liveliest {MOST_SAMPLES} samples" if longest > MOST_SAMPLES else ""
    if not parts.held_out:
        raise InputError(
            f"found one trial, '{trials[0].name}', which moves in one half only; give several "
            "trials, or name some with --hold-out"
        )
    return Split(
        parts.fitted,
        parts.held_out,
        parts.what_is_held_out + cut,
        parts.rule,
        parts.numbers,
        Rules() if rules is None else rules,
    )


def _liveliest(prepared: Prepared) -> Prepared:
    """Of a long record as much as is fitted, where it moves most."""
    first, last = prepared.first, prepared.last
    if last - first <= MOST_SAMPLES:
        return prepared
    response = prepared.response[first:last]
    energy = np.cumsum(np.square(response - response.mean()))
    before = np.append(0.0, energy[:-MOST_SAMPLES])
    begin = first + int(np.argmax(energy[MOST_SAMPLES - 1 :] - before))
    return prepared.part(begin, begin + MOST_SAMPLES)
