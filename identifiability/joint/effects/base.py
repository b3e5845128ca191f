"""What every physical effect declares, and the signals it sees."""

from __future__ import annotations

import hashlib
from abc import ABC
from collections.abc import Collection, Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.check import check_effect
from identifiability.joint.parameters import Parameter

TYPICAL_ANGLE = 0.1  # rad, that joints are moved by: where an effect's pace depends on the motion


class Motion(NamedTuple):
    """Angle [rad] and angular velocity [rad/s] that an effect sees."""

    angle: ArrayLike
    velocity: ArrayLike


class Effect(ABC):
    """A physical effect that can be added to a joint model with ``+``.

    A subclass states its parameters and where it acts; the model does the rest. ``place`` is

    ``"joint"``
        a torque in parallel with everything else that spans the joint; it sees the joint's motion;
    ``"muscle"``
        a torque in parallel with K and B, and like them in series with a tendon, if there is one;
        it sees the motion of the contractile element;
    ``"series"``
        an elastic element between the muscle and the joint; ``torque`` is its torque at a stretch
        (in rad) and has no states of its own; ``bypass`` is what acts beside it and the muscle;
    ``"coupling"``
        a link between a body that is driven and measured, and the limb behind it with all else;
        ``torque`` is its torque at a stretch and its rate, and ``before`` the share of the inertia
        I that is that body's. A model has one at most. What is delayed is the body's motion;
    ``"sensor"``
        nothing in the joint: ``record`` says what the instruments make of the true response.

    Class attributes
    ----------------
    key : stable name used in reports and parameter names
    title : the effect's name in a sentence
    parameters : the effect's parameters
    place : see above
    linear : whether torque and rates are linear in motion and states
    affine_in_velocity : whether the torque is affine in the velocity (muscle effects)
    n_states : number of the effect's own states
    reads_between : whether ``record`` needs the response between the samples too
    confused_with : keys of effects that look alike in short records
    equivalent : keys of effects of the same form: no torque and angle tells them apart
    refines : keys of effects of which it is a richer form
    references : where the equations come from

    They are checked where the class is made. Two effects are equal where class and fields are: a
    field is a number of one's own that is not fitted.

    Raises
    ------
    InputError
        Where a class attribute is missing or cannot be right.
    """

    key: ClassVar[str]
    title: ClassVar[str] = ""
    parameters: ClassVar[tuple[Parameter, ...]]
    place: ClassVar[Literal["joint", "muscle", "series", "coupling", "sensor"]]
    linear: ClassVar[bool]
    affine_in_velocity: ClassVar[bool] = True
    n_states: ClassVar[int] = 0
    reads_between: ClassVar[bool] = False
    confused_with: ClassVar[tuple[str, ...]] = ()
    equivalent: ClassVar[tuple[str, ...]] = ()
    refines: ClassVar[tuple[str, ...]] = ()
    references: ClassVar[tuple[str, ...]] = ()

    @property
    def has_refinement(self) -> bool:
        """Whether some of its parameters only refine it: see `Parameter.plain`."""
        return any(parameter.plain is not None for parameter in self.parameters)

    def refinable(self, others: Collection[Effect]) -> bool:
        """Whether what refines it can be told from other parameters, beside other effects.

        Parameters
        ----------
        others : collection of Effect
        """
        return self.has_refinement

    def bypass(self, p: Sequence[Array], motion: Motion) -> ArrayLike:
        """Torque [Nm] beside muscle and elastic element, at the motion of the joint.

        Parameters
        ----------
        p : sequence of scalars
            The effect's parameters.
        motion : Motion
            Angle [rad] and velocity [rad/s] of the joint.
        """
        return 0.0

    def before(self, p: Sequence[Array]) -> ArrayLike:
        """Share of the inertia that is before a coupling."""
        return 1.0

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque with which the effect resists the motion.

        Parameters
        ----------
        p : sequence of scalars
            The effect's parameters, in the order of ``parameters``.
        motion : Motion
            Present angle [rad] and velocity [rad/s].
        states : array, shape (n_states,)
            The effect's own states.
        delayed : Motion
            The joint's motion ``delay(p)`` seconds ago (at rest before the record begins).

        Returns
        -------
        scalar
            Torque [Nm], positive where it opposes a positive angle.
        """
        return 0.0

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Time derivatives of the effect's states, shape (n_states,); arguments as in `torque`."""
        return jnp.zeros(0)

    def delay(self, p: Sequence[Array]) -> ArrayLike | None:
        """Delay [s] of the motion passed as ``delayed``; ``None`` for an effect without delay."""
        return None

    def record(self, p: Sequence[Array], response: Array, interval: ArrayLike) -> Array:
        """What is recorded of a response: for effects of the sensor.

        Parameters
        ----------
        p : sequence of scalars
        response : array, shape (n,)
            True response: angle [rad] to an imposed torque, torque [Nm] to an imposed angle.
        interval : float
            Time [s] from one value to the next: the sampling interval, or a part of it where the
            effect reads between the samples.

        Returns
        -------
        array, shape (n,)
        """
        return response

    def typical(self, values: Mapping[str, float]) -> Mapping[str, tuple[float, float]]:
        """Parameters that go with the joint's own size: a typical value, and by how much they vary.

        Parameters
        ----------
        values : mapping of str to float
            Values by full name.

        Returns
        -------
        mapping of str to (float, float)
            By full name a median, and the standard deviation of the logarithm about it.
        """
        return {}

    def objection(self, values: Mapping[str, float]) -> str:
        """Why fitted values cannot be those of a joint, beyond what bounds can say.

        Parameters
        ----------
        values : mapping of str to float
            All parameters of the model by their full names, ``K`` and ``gravity.moment`` say.

        Returns
        -------
        str
            Empty where there is no objection. A model with one is not weighed.
        """
        return ""

    def blurred(self, values: Mapping[str, float], noise: float) -> str:
        """Why an angle that is imposed, and recorded with noise, cannot show the effect so small.

        Parameters
        ----------
        values : mapping of str to float
            See `objection`.
        noise : float
            Standard deviation of the recorded angle [rad].

        Returns
        -------
        str
            Empty where it can. A model with such an effect is not weighed.
        """
        return ""

    def doubt(self, values: Mapping[str, float]) -> str:
        """Why fitted values, though a joint may have them, are more likely those of another effect.

        Parameters
        ----------
        values : mapping of str to float
            All parameters of the model by their full names.

        Returns
        -------
        str
            Empty where there is no doubt. A verdict that names the effect says it.
        """
        return ""

    def pace(self, values: Mapping[str, float]) -> float:
        """Fastest rate of change that the effect adds to the joint's linearisation at rest.

        The steps of the integrator follow from it; it may be the rate of motions of 0.1 rad and 1
        rad/s where it grows with the motion. Every fit that is quoted is integrated again with half
        the step, so an effect that says nothing (0) costs time and not truth.

        Parameters
        ----------
        values : mapping of str to float
            All parameters of the model by their full names.

        Returns
        -------
        float
            In 1/s.
        """
        return 0.0

    def settling(self, values: Mapping[str, float]) -> float:
        """Fastest rate at which the effect's own states settle, where that bounds its steps.

        Under an imposed angle, states that are linear in themselves ask for no more than steps that
        are stable; these then follow from this rate, and no longer from `pace`.

        Parameters
        ----------
        values : mapping of str to float
            All parameters of the model by their full names.

        Returns
        -------
        float
            In 1/s; 0 where the steps follow from `pace`.
        """
        return 0.0

    @property
    def kind(self) -> Literal["physics", "measurement"]:
        """Whether the effect is in the joint or in the instruments."""
        return "measurement" if self.place == "sensor" else "physics"

    @property
    def has_memory(self) -> bool:
        """Whether its torque depends on the past of the joint's motion."""
        return self.place in ("series", "coupling") or self.n_states > 0

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        check_effect(cls)

    def _fields(self) -> tuple[tuple[str, Hashable], ...]:
        kind = type(self)
        return tuple(
            (name, _frozen(value))
            for name, value in sorted(vars(self).items())
            if not isinstance(getattr(kind, name, None), cached_property)
        )

    # A compiled program is shared by equal effects, so what makes them differ must count.
    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._fields() == other._fields()

    def __hash__(self) -> int:
        return hash((type(self), self._fields()))

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={value!r}" for name, value in self._fields())
        return f"{type(self).__name__}({fields})"


def _frozen(value: Any) -> Hashable:
    """A field as a value that can be compared and hashed."""
    if isinstance(value, np.ndarray | Array):
        array = np.asarray(value)
        return "array", array.shape, str(array.dtype), hashlib.sha256(array.tobytes()).hexdigest()
    if isinstance(value, Mapping):
        return tuple(sorted((str(key), _frozen(part)) for key, part in value.items()))
    if isinstance(value, list | tuple):
        return tuple(_frozen(part) for part in value)
    return value
