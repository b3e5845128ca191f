"""A joint model: inertia, damping, stiffness, and the effects added to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from identifiability.errors import InputError
from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

KBI_PARAMETERS = (
    Parameter("K", "K", "Nm/rad", 50.0, 0.0, 2000.0, "stiffness"),
    Parameter("B", "B", "Nms/rad", 1.0, 0.0, 50.0, "damping"),
    Parameter("I", "I", "kg m²", 0.1, 0.005, 1.0, "inertia"),
)

Imposed = Literal["torque", "angle"]
"""What is imposed on a joint; the other is its response."""

_NEWTON_STEPS = 6

_Given = Sequence[tuple[Sequence[Array], Array, Motion]]
"""Parameters, own states and delayed motion of each effect."""


class Reaction(NamedTuple):
    """Torque [Nm] that resists a motion, and the rates of the model's internal states."""

    torque: Array
    rates: Array


@dataclass(frozen=True)
class Model:
    """A joint: inertia, damping and stiffness, plus any number of effects.

    Build it with ``KBI()`` and ``+``; it is immutable, hashable and holds no parameter values.
    Parameters are always passed as a vector in the order of ``parameter_names``.

    Attributes
    ----------
    effects : tuple of Effect
        The effects, in the order of their keys.
    """

    effects: tuple[Effect, ...] = ()

    def __add__(self, other: object) -> Model:
        if not isinstance(other, Effect):
            found = f"the class {other.__name__}" if isinstance(other, type) else f"{other!r}"
            raise TypeError(
                f"only effects can be added to a joint model, found {found}; "
                "write for example KBI() + SeriesTendon()"
            )
        try:
            hash(other)
        except TypeError:
            raise InputError(
                f"found a field of {type(other).__name__} that can change, expected numbers, words "
                "and tuples; write @dataclass(frozen=True) over an effect that is a dataclass"
            ) from None
        if other.key in self.effect_keys:
            raise InputError(f"the model already has the effect '{other.key}'; add it once")
        if other.place == "coupling" and self._coupling is not None:
            raise InputError(
                f"the model already has the coupling '{self._coupling.key}' before the limb; add "
                f"'{other.key}' to the model without it"
            )
        # The order of addition must not change names or numbers, so effects are kept sorted.
        return Model(tuple(sorted((*self.effects, other), key=lambda effect: effect.key)))

    def plus(self, effects: Iterable[Effect]) -> Model:
        """Return the model with several effects more, in their order."""
        model = self
        for effect in effects:
            model = model + effect
        return model

    def takes(self, effect: type[Effect] | Effect) -> bool:
        """Whether an effect can be added: it has none of its key, and one coupling at most."""
        taken = effect.place == "coupling" and self._coupling is not None
        return effect.key not in self.effect_keys and not taken

    def without(self, key: str) -> Model:
        """Return the model without the effect `key`.

        Raises
        ------
        InputError
            Where the model has no such effect.
        """
        unwanted = self.effect(key)
        return Model(tuple(effect for effect in self.effects if effect is not unwanted))

    def __repr__(self) -> str:
        return " + ".join(["KBI()", *(repr(effect) for effect in self.effects)])

    @property
    def effect_keys(self) -> tuple[str, ...]:
        """Keys of the effects."""
        return tuple(effect.key for effect in self.effects)

    def effect(self, key: str) -> Effect:
        """Return the effect `key`.

        Raises
        ------
        InputError
            Where the model has no such effect.
        """
        if key not in self.effect_keys:
            raise InputError(f"the model has no effect '{key}', it has {list(self.effect_keys)}")
        return self.effects[self.effect_keys.index(key)]

    def refinable(self, keys: Iterable[str]) -> tuple[str, ...]:
        """Those of some effects that it has, and whose refining parameters show beside the others.

        Parameters
        ----------
        keys : iterable of str
            Of effects.
        """
        others = {key: [e for e in self.effects if e.key != key] for key in self.effect_keys}
        return tuple(k for k in keys if k in others and self.effect(k).refinable(others[k]))

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by full name: ``K``, ``B``, ``I``, then ``effect_key.name``."""
        named = {parameter.name: parameter for parameter in KBI_PARAMETERS}
        for effect in self.effects:
            named |= {f"{effect.key}.{p.name}": p for p in effect.parameters}
        return named

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Full names, in the order of the parameter vector."""
        return tuple(self.parameters)

    @property
    def lower(self) -> np.ndarray:
        """Lower physical bounds, shape (n_parameters,)."""
        return np.array([p.lower for p in self.parameters.values()])

    @property
    def upper(self) -> np.ndarray:
        """Upper physical bounds, shape (n_parameters,)."""
        return np.array([p.upper for p in self.parameters.values()])

    @property
    def nominal(self) -> np.ndarray:
        """Typical values, shape (n_parameters,)."""
        return np.array([p.nominal for p in self.parameters.values()])

    @property
    def references(self) -> tuple[str, ...]:
        """Sources of the equations of all effects."""
        return tuple(ref for effect in self.effects for ref in effect.references)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Parameter vector from values by name.

        Those that only refine an effect may be left out: it then has its plain form.

        Raises
        ------
        InputError
            Where a name is missing or unknown.
        """
        plain = {name: p.plain for name, p in self.parameters.items() if p.plain is not None}
        given = {**plain, **values}
        if set(given) != set(self.parameter_names):
            raise InputError(
                f"found values for {sorted(values)}, expected {list(self.parameter_names)}; "
                "give exactly one value for each"
            )
        return np.array([float(given[name]) for name in self.parameter_names])

    @cached_property
    def linear(self) -> bool:
        """Whether the joint is linear without delayed feedback: it then has exact responses."""
        nominal = jnp.asarray(self.nominal)
        return all(
            effect.linear and effect.delay(p) is None
            for effect, p in zip(self.effects, self._effect_parameters(nominal), strict=True)
        )

    def objection(self, values: Mapping[str, float]) -> str:
        """Why values of parameters, by name, cannot be those of a joint; empty if they can."""
        return "; ".join(filter(None, (effect.objection(values) for effect in self.effects)))

    def blurred(self, values: Mapping[str, float], noise: float) -> str:
        """Why an imposed angle recorded with this noise [rad] cannot show effects so small."""
        why = (effect.blurred(values, noise) for effect in self.effects)
        return "; ".join(filter(None, why))

    @property
    def delayed(self) -> bool:
        """Whether some effect sees the motion that was a delay ago."""
        return any(delay is not None for delay in self.delays(self.nominal))

    def pace(self, values: Mapping[str, float], imposed: Imposed = "torque") -> float:
        """Fastest rate [1/s] of what is integrated and not linear; see `Effect.pace`.

        Under an imposed angle only the internal states are integrated, the limb behind a coupling
        among them.
        """
        chosen = self.effects
        if not self._moves(imposed):
            chosen = tuple(e for e in self._inner if not e.settling(values))
        try:
            paces = [abs(effect.pace(values)) for effect in chosen]
        except (ArithmeticError, ValueError):
            return math.inf  # of parameters that no joint has
        return float(np.nan_to_num(max(paces, default=0.0), nan=np.inf))

    def settling(self, values: Mapping[str, float], imposed: Imposed = "torque") -> float:
        """Fastest rate [1/s] at which states settle that take no other steps than stable ones.

        See `Effect.settling`; there are none where the joint moves by its own dynamics.
        """
        rates = [e.settling(values) for e in self._inner if not self._moves(imposed)]
        return max(rates, default=0.0)

    @property
    def n_internal(self) -> int:
        """Number of states besides the joint's own angle and velocity."""
        return self._n_between + sum(effect.n_states for effect in self.effects)

    def inertia(self, theta: ArrayLike) -> Array:
        """Inertia [kg m²] of what is driven and measured: the joint's, or that before a coupling.

        Parameters
        ----------
        theta : array, shape (n_parameters,)
        """
        theta = jnp.asarray(theta)
        return theta[2] * self._before(self._effect_parameters(theta))

    def delays(self, theta: ArrayLike) -> list[Array | None]:
        """Delay [s] of each effect, ``None`` where it has none."""
        per_effect = self._effect_parameters(jnp.asarray(theta))
        raw = [e.delay(p) for e, p in zip(self.effects, per_effect, strict=True)]
        return [None if d is None else jnp.asarray(d) for d in raw]

    def react(
        self, theta: ArrayLike, motion: Motion, internal: Array, delayed: Sequence[Motion]
    ) -> Reaction:
        """Torque that resists a motion of what is driven and measured, without its inertia.

        Parameters
        ----------
        theta : array, shape (n_parameters,)
        motion : Motion
            Angle and velocity.
        internal : array, shape (n_internal,)
            Angle and velocity of the limb behind a coupling, if there is one, angle of the
            contractile element, if there is a tendon, then the effects' own states.
        delayed : sequence of Motion
            For each effect the motion one delay ago.

        Returns
        -------
        Reaction
        """
        theta = jnp.asarray(theta)
        per_effect = self._effect_parameters(theta)
        states, first = [], self._n_between
        for effect in self.effects:
            states.append(internal[first : first + effect.n_states])
            first += effect.n_states

        given = list(zip(per_effect, states, delayed, strict=True))

        def torque_of(place: str, seen: Motion, given: _Given = given) -> Array:
            parts = (
                effect.torque(p, seen, own, past)
                for effect, (p, own, past) in zip(self.effects, given, strict=True)
                if effect.place == place
            )
            return sum((jnp.asarray(part) for part in parts), start=jnp.zeros(()))

        def muscle(seen: Motion, theta: Array = theta, given: _Given = given) -> Array:
            angle, velocity = jnp.asarray(seen.angle), jnp.asarray(seen.velocity)
            return theta[0] * angle + theta[1] * velocity + torque_of("muscle", seen, given)

        rates: list[Array] = []
        driven, coupling = motion, self._coupling
        if coupling is not None:
            motion = Motion(internal[0], internal[1])
            stretch, slip = (jnp.asarray(a) - b for a, b in zip(driven, motion, strict=True))
            load = torque_of("coupling", Motion(stretch, slip))
        contractile = motion
        if self._has_tendon:
            # The element moves such that it carries the tendon's torque.
            angle = internal[self._n_between - 1]
            tension = torque_of("series", Motion(motion.angle - angle, 0.0))
            affine = all(e.affine_in_velocity for e in self.effects if e.place == "muscle")
            held = jax.lax.stop_gradient((theta, given, angle, tension))

            def excess(v: Array, fixed: bool = False) -> Array:
                at, known, where, carried = held if fixed else (theta, given, angle, tension)
                return muscle(Motion(where, v), at, known) - carried

            velocity = _balance(excess, affine)
            contractile = Motion(angle, velocity)
            rates.append(jnp.reshape(velocity, (1,)))
            torque = tension + sum(
                (
                    jnp.asarray(effect.bypass(p, motion))
                    for effect, (p, _, _) in zip(self.effects, given, strict=True)
                    if effect.place == "series"
                ),
                start=jnp.zeros(()),
            )
        else:
            torque = muscle(motion)
        torque = torque + torque_of("joint", motion)
        for effect, p, own, past in zip(self.effects, per_effect, states, delayed, strict=True):
            if effect.n_states:
                seen = contractile if effect.place == "muscle" else motion
                rates.append(jnp.asarray(effect.rates(p, seen, own, past)))
        if coupling is not None:
            behind = theta[2] * (1 - self._before(per_effect))
            rates.insert(0, jnp.stack([motion.velocity, (load - torque) / behind]))
            torque = load
        return Reaction(jnp.asarray(torque), jnp.concatenate([*rates, jnp.zeros(0)]))

    def record(self, theta: ArrayLike, response: Array, interval: ArrayLike) -> Array:
        """What the instruments make of the true response of the joint.

        Parameters
        ----------
        theta : array, shape (n_parameters,)
        response : array, shape (n,)
            Angle [rad] to an imposed torque, torque [Nm] to an imposed angle.
        interval : float
            Time [s] from one value to the next.

        Returns
        -------
        array, shape (n,)
        """
        per_effect = self._effect_parameters(jnp.asarray(theta))
        for effect, p in zip(self.effects, per_effect, strict=True):
            response = effect.record(p, response, interval)
        return response

    @property
    def _has_tendon(self) -> bool:
        return any(effect.place == "series" for effect in self.effects)

    @property
    def _coupling(self) -> Effect | None:
        return next((effect for effect in self.effects if effect.place == "coupling"), None)

    @property
    def _inner(self) -> tuple[Effect, ...]:
        """Effects that take part in the rates of internal states."""
        tendon = self._has_tendon
        return tuple(e for e in self.effects if e.has_memory or (e.place == "muscle" and tendon))

    def _moves(self, imposed: Imposed) -> bool:
        """Whether inertia is among what is integrated."""
        return imposed == "torque" or self._coupling is not None

    @property
    def _n_between(self) -> int:
        """States of what stands between: the limb behind a coupling, the end of a tendon."""
        return 2 * (self._coupling is not None) + self._has_tendon

    def _before(self, per_effect: Sequence[Sequence[Array]]) -> ArrayLike:
        """Share of the inertia that is driven and measured."""
        shares = (
            effect.before(p)
            for effect, p in zip(self.effects, per_effect, strict=True)
            if effect.place == "coupling"
        )
        return next(shares, 1.0)

    def _effect_parameters(self, theta: Array) -> list[Sequence[Array]]:
        parts: list[Sequence[Array]] = []
        first = len(KBI_PARAMETERS)
        for effect in self.effects:
            parts.append([theta[first + i] for i in range(len(effect.parameters))])
            first += len(effect.parameters)
        return parts


def _balance(excess: Callable[..., Array], affine: bool) -> Array:
    """Velocity at which an increasing function of it is zero.

    Newton steps from rest, which approach the root of a saturating damping from one side. The last
    two are differentiated, so that first and second derivatives are those of the root; the others
    take a function whose parameters are fixed, for which there is less to trace and compile.
    """

    def closer(velocity: Array, fixed: bool) -> Array:
        value, slope = jax.jvp(lambda v: excess(v, fixed), (velocity,), (jnp.ones(()),))
        # Without damping the balance would be static: hence the tiny floor.
        return velocity - value / jnp.where(jnp.abs(slope) < 1e-9, 1e-9, slope)

    velocity = jnp.zeros(())
    steps = 1 if affine else _NEWTON_STEPS
    for step in range(steps):
        velocity = closer(velocity, step < steps - 2)
    return velocity


def KBI() -> Model:
    """Joint of inertia, damping and stiffness (Eq. 2): ``Z(s) = K + B s + I s²``."""
    return Model()
