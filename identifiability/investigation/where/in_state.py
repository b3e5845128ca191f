"""In which angles and velocities a model fails, as the torque that is missing there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from scipy import linalg, signal, stats

from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.where.drawing import points
from identifiability.investigation.where.numerals import probability
from identifiability.investigation.where.scene import Scene
from identifiability.investigation.where.view import Panel, View
from identifiability.investigation.where.whitening import Portion, excess
from identifiability.measurement.noise import correlation_time
from identifiability.measurement.prepared import Prepared
from identifiability.palette import BLUE, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_KNOTS, _REACH = 9, 0.995  # of angle and velocity each, an odd number; quantile that they span
_DETERMINED = 0.03  # least singular value of the regression on torques, relative to the largest


@dataclass(frozen=True, eq=False)
class Curve:
    """Unexplained torque against angle or velocity.

    Attributes
    ----------
    at : array, shape (n,)
        Angle [rad] or velocity [rad/s].
    torque, errors : array, shape (n,)
        Torque [Nm] that resists the motion beyond what the model says, and its standard error. It
        is 0 at rest, and has no linear part: K and B would take that up.
    flags : array, shape (n,)
        Where it is significant.
    share : float
        Share of the misfit, beyond the noise, that this curve alone explains.
    """

    at: np.ndarray
    torque: np.ndarray
    errors: np.ndarray
    flags: np.ndarray
    share: float


@dataclass(frozen=True, eq=False)
class StateView(View):
    """Unexplained torque as the sum of one that depends on the angle and one on the velocity.

    Attributes
    ----------
    angle, velocity : Curve or None
        ``None`` where the trials visit too few states.
    share : float
        Share of the misfit, beyond the noise, that both explain together.
    p_value : float
    """

    name: ClassVar[str] = "state"

    angle: Curve | None
    velocity: Curve | None
    share: float
    p_value: float

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Unexplained torque against angle and velocity, by generalised least squares.

        A torque f(angle) + g(velocity), both piecewise linear, acts on the joint that the model
        says it is (with the candidate's K, B and I), and the response to it is fitted to the
        whitened residual together with changes of K, B and I and of the trials' levels. This needs
        no second derivative of the measured angle. A torque over the plane of both is not
        determined by transients, each of which visits one line in it.
        """
        motions = [
            _motion(ready, left)
            for ready, left in zip(scene.parts, scene.candidate.fitted.by_trial, strict=True)
        ]
        knots = [_knots(np.concatenate([motion[k] for motion in motions])) for k in (0, 1)]
        _, slopes = scene.refits.linearised(scene.refits.values)
        values, nuisance, forced = [], [], []
        often = np.zeros(2 * _KNOTS)
        for i, (ready, b) in enumerate(scene.observed):
            hats = np.column_stack([_hats(x, k) for x, k in zip(motions[i], knots, strict=True)])
            often += np.sum(hats[b.index[:, 0]] ** 2, axis=0)
            forced.append(scene.noise.averaged(i, _response_to(scene, ready, hats), b.index))
            levels = np.zeros((len(b.values), len(scene.parts)))
            ones = np.ones((len(hats), 1))
            levels[:, i] = scene.noise.averaged(i, ones, b.index)[:, 0]
            nuisance.append(np.column_stack([scene.noise.averaged(i, slopes[i], b.index), levels]))
            values.append(b.values)
        taken = _span(np.concatenate(nuisance))
        design, left = (
            rows - taken @ (taken.T @ rows) for rows in map(np.concatenate, (forced, values))
        )
        misfit = float(left @ left) - (left.size - taken.shape[1])
        both, angle, velocity = (
            _regression(left, design, knots, often, parts) for parts in ((0, 1), (0,), (1,))
        )
        if not both.rank:
            return cls(False, scene.noise.known, None, None, 0.0, 1.0)
        owner = np.repeat(np.arange(len(scene.parts)), [len(b.values) for b in scene.blocks])
        numbers = np.bincount(owner, both.leverage, len(scene.parts))
        portions = [
            Portion(float(n), 0.0, float(dof))
            for n, dof in zip(numbers, scene.noise.dof, strict=True)
        ]
        p_value = excess(both.gained, portions, scene.slow_slack)[1]
        shares = [
            float(np.clip((fit.gained - fit.rank) / misfit, 0.0, 1.0)) if misfit > 0 else 0.0
            for fit in (both, angle, velocity)
        ]
        p_values = 2 * stats.norm.sf(np.abs(both.torque) / np.maximum(both.errors, 1e-300))
        flags = scene.significant(p_values)
        by_angle, by_velocity = (
            Curve(knots[k], both.torque[part], both.errors[part], flags[part], shares[1 + k])
            for k, part in enumerate((slice(0, _KNOTS), slice(_KNOTS, None)))
        )
        found = p_value <= scene.level
        return cls(found, scene.noise.known, by_angle, by_velocity, shares[0], p_value)

    def words(self) -> str:
        """What share of the misfit a torque of the present state would explain."""
        if self.angle is None or self.velocity is None:
            return "The trials visit too few states to tell where in them the model fails."
        if not self.significant:
            return (
                "No torque that depends on angle and velocity alone is missing "
                f"({probability(self.p_value)})."
            )
        return (
            "A torque that depends on the present angle and velocity would explain "
            f"{100 * self.share:.0f} % of the misfit, one that depends on the angle alone "
            f"{100 * self.angle.share:.0f} %, on the velocity alone "
            f"{100 * self.velocity.share:.0f} %."
        )

    def panels(self) -> tuple[Panel, ...]:
        """The torque by angle, and by velocity."""
        curves = {"angle [rad]": self.angle, "velocity [rad/s]": self.velocity}
        return tuple(
            Panel(f"by {what.split()[0]}", partial(_draw, curve, what, self.significant))
            for what, curve in curves.items()
            if curve is not None
        )


def _draw(curve: Curve, what: str, explains: bool, panel: Axes) -> None:
    panel.axhline(0, color=GREY, lw=0.8)
    panel.errorbar(curve.at, curve.torque, NORMAL_95 * curve.errors, color=BLUE)
    points(panel, curve.at, curve.torque, curve.flags)
    panel.set_xlabel(what)
    panel.set_ylabel("missing torque [Nm]")
    if explains:
        panel.annotate(
            f"explains {100 * curve.share:.0f} % of the misfit",
            (0.98, 0.98),
            xycoords="axes fraction",
            ha="right",
            va="top",
        )
        low, high = panel.get_ylim()
        panel.set_ylim(low, high + 0.15 * (high - low))


@dataclass(frozen=True, eq=False)
class _Regression:
    """A residual explained by torques at knots."""

    torque: np.ndarray
    errors: np.ndarray
    gained: float
    rank: int
    leverage: np.ndarray


def _regression(
    left: np.ndarray,
    design: np.ndarray,
    knots: Sequence[np.ndarray],
    often: np.ndarray,
    parts: Sequence[int],
) -> _Regression:
    """Fit torques at the knots of angle (0), velocity (1) or both.

    They are in units of the torque times the root of the time spent there, and are orthogonal to
    the linear torques; of what is ill determined the smallest is taken.
    """
    basis = np.zeros((2 * _KNOTS, 0))
    for k in parts:
        # At rest there is no torque, and what is not visited is not asked for.
        used = k * _KNOTS + np.flatnonzero((knots[k] != 0) & (often[k * _KNOTS :][:_KNOTS] >= 1))
        if used.size < 3:
            continue
        root = np.sqrt(often[used])[:, None]
        block = np.zeros((2 * _KNOTS, used.size - 1))
        block[used] = _orthogonal_to(root * knots[k][used - k * _KNOTS][:, None]) / root
        basis = np.column_stack([basis, block])
    none = np.zeros(2 * _KNOTS)
    if not basis.size:
        return _Regression(none, none, 0.0, 0, np.zeros(left.size))
    reduced = design @ basis
    inverse = np.linalg.pinv(reduced, rcond=_DETERMINED)
    leverage = np.sum(reduced * inverse.T, axis=1)
    coefficients = inverse @ left
    remaining = left - reduced @ coefficients
    spread = max(1.0, float(np.mean(remaining**2)) * correlation_time(remaining))
    return _Regression(
        basis @ coefficients,
        np.sqrt(spread * np.sum((basis @ inverse) ** 2, axis=1)),
        float(left @ left - remaining @ remaining),
        round(float(leverage.sum())),
        np.maximum(leverage, 0.0),
    )


def _knots(values: np.ndarray) -> np.ndarray:
    """Places symmetric about 0 that span most values, closer near rest."""
    reach = max(float(np.quantile(np.abs(values), _REACH)), 1e-12)
    place = np.linspace(-1, 1, _KNOTS)
    return np.asarray(reach * np.sign(place) * np.abs(place) ** 1.5)


def _hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Functions that are 1 at one knot and fall to 0 at its neighbours, shape (n, n_knots)."""
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(knots.size)])


def _motion(ready: Prepared, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity at the compared samples; of an imposed torque, as the model has them."""
    if ready.trial.driven == "angle":
        signals = ready.drive.signals[ready.first : ready.last]
        return signals[:, 0], signals[:, 1]
    angle = ready.compared - left
    return angle, np.gradient(angle, ready.drive.interval)


def _response_to(scene: Scene, ready: Prepared, torque: np.ndarray) -> np.ndarray:
    """Change of the response to additional resisting torques, shape (n, k)."""
    if ready.trial.driven == "angle":
        return torque
    K, B, I = scene.refits.values
    system = np.array([[0.0, 1.0, 0.0], [-K / I, -B / I, 1 / I], [0.0, 0.0, 0.0]])
    # Motion is slow within a sample: the torque is as good as constant.
    step = linalg.expm(system * ready.drive.interval)
    forward = [0.0, step[0, 2], step[0, 1] * step[1, 2] - step[1, 1] * step[0, 2]]
    back = [1.0, -step[0, 0] - step[1, 1], step[0, 0] * step[1, 1] - step[0, 1] * step[1, 0]]
    return -np.asarray(signal.lfilter(forward, back, torque, axis=0))


def _orthogonal_to(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what is orthogonal to some columns."""
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=True)
    rank = int(np.sum(sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)))
    return np.asarray(vectors[:, rank:])


def _span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what some columns span."""
    norms = np.linalg.norm(columns, axis=0)
    vectors, sizes, _ = np.linalg.svd(columns[:, norms > 0] / norms[norms > 0], full_matrices=False)
    return np.asarray(vectors[:, sizes > 1e-9])
