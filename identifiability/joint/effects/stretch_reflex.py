"""The stretch reflex: feedback of length and velocity after a delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.activation import approach, kink, off_ratio
from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_SHORTEST = 0.02
"""Delay (s) below which there is no reflex of a limb: the arm's muscles begin to answer 20 ms after
a stretch (Kurtzer 2015, Front Integr Neurosci 8: 99)."""
_AT = 1.02  # times the shortest delay, within which a fit wanted less


class StretchReflex(Effect):
    r"""Delayed feedback of stretch and stretch velocity through second-order activation.

    Each muscle of an antagonist pair answers its own stretch:

    .. math::
        s &= G_p\,\theta(t-d) + G_v\,\dot\theta(t-d) \\
        u_+ &= w_+ \max(s - G_v c, 0), \qquad u_- = w_- \max(-s - G_v c, 0) \\
        \tau_\pm \dot a_1 &= u - a_1 + (\zeta^{-2} - 1)(u - a_2), \qquad
        \tau_\pm \dot a_2 = a_1 - a_2

    and T is the difference of the two muscles' a_2: a second-order system of damping ratio
    :math:`\zeta` and natural frequency :math:`1 / (\zeta \tau)`. In its plain form (no asymmetry,
    no velocity threshold, activation as fast off as on, critically damped) this is linear. With an
    asymmetry of 1 only positive stretch is answered, with -1 only negative. It vanishes with both
    gains 0.
    """

    key = "stretch_reflex"
    title = "a stretch reflex"
    place = "joint"
    linear = False
    n_states = 4
    confused_with = ("activation_lag", "sensor_delay", "second_mass")
    parameters = (
        Parameter(
            "position_gain",
            "G_p",
            "Nm/rad",
            nominal=10.0,
            lower=0.0,
            upper=2000.0,
            null=0.0,
            description="torque per delayed stretch",
        ),
        Parameter(
            "velocity_gain",
            "G_v",
            "Nms/rad",
            nominal=0.5,
            lower=0.0,
            upper=500.0,
            null=0.0,
            description="torque per delayed stretch velocity",
        ),
        Parameter(
            "delay",
            "d",
            "s",
            nominal=0.04,
            lower=_SHORTEST,
            upper=0.15,
            description="delay of the reflex loop: 20 ms in the arm, 40 in the leg, more if learnt",
            is_delay=True,
        ),
        Parameter(
            "time_constant",
            r"\tau_r",
            "s",
            nominal=0.03,
            lower=0.002,
            upper=0.3,
            description="time constant of activation, which it passes twice",
        ),
        Parameter(
            "asymmetry",
            "a_r",
            "1",
            nominal=0.0,
            lower=-1.0,
            upper=1.0,
            plain=0.0,
            description="1: only positive stretch is answered, -1: only negative",
        ),
        Parameter(
            "threshold",
            "c",
            "rad/s",
            nominal=0.0,
            lower=0.0,
            upper=5.0,
            plain=0.0,
            description="stretch velocity below which there is no response",
        ),
        off_ratio(r"\rho"),
        Parameter(
            "damping_ratio",
            r"\zeta",
            "1",
            nominal=1.0,
            lower=0.4,
            upper=4.0,
            plain=1.0,
            description="of activation: below 1 it overshoots, far above it is of first order",
        ),
    )
    references = (
        "Kearney, Stein & Parameswaran 1997, IEEE Trans Biomed Eng 44: 493-504",
        "Mirbagheri, Barbeau & Kearney 2000, Exp Brain Res 135: 423-436",
        "Thelen 2003, J Biomech Eng 125: 70-77 (activation and deactivation)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the reflex, the difference of the two muscles."""
        return states[1] - states[3]

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Activation of the two muscles."""
        position, velocity, _, tau, asymmetry, threshold, ratio, damping = p
        overshoot = 1.0 / damping**2 - 1.0
        signal = position * delayed.angle + velocity * delayed.velocity
        quiet = velocity * threshold
        excited = (
            jnp.minimum(1.0, 1.0 + asymmetry) * jnp.maximum(signal - quiet, 0.0),
            jnp.minimum(1.0, 1.0 - asymmetry) * jnp.maximum(-signal - quiet, 0.0),
        )

        return jnp.stack(
            [
                rate
                for u, first, second in zip(excited, states[::2], states[1::2], strict=True)
                for rate in (
                    approach(u - first + overshoot * (u - second), tau, ratio),
                    approach(first - second, tau, ratio),
                )
            ]
        )

    def delay(self, p: Sequence[Array]) -> ArrayLike:
        """Delay [s] of the reflex loop."""
        return p[2]

    def pace(self, values: Mapping[str, float]) -> float:
        """Difference between the rates of activation and deactivation."""
        return kink(self.key, values)

    def doubt(self, values: Mapping[str, float]) -> str:
        """Whether the delay is the shortest possible: the fit wanted something quicker."""
        if values[f"{self.key}.delay"] > _AT * _SHORTEST:
            return ""
        return f"a delay of {1e3 * _SHORTEST:.0f} ms is the shortest that any reflex of a limb has"
