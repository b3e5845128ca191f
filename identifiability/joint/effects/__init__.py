"""The registry: every effect the package knows, by key."""

from identifiability.joint.effects.activation_lag import ActivationLag
from identifiability.joint.effects.backlash import Backlash
from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.effects.coulomb_friction import CoulombFriction
from identifiability.joint.effects.cubic_stiffness import CubicStiffness
from identifiability.joint.effects.damping_by_angle import DampingByAngle
from identifiability.joint.effects.damping_by_direction import DampingByDirection
from identifiability.joint.effects.end_stop import EndStop
from identifiability.joint.effects.gravity import Gravity
from identifiability.joint.effects.hill_force_velocity import HillForceVelocity
from identifiability.joint.effects.maxwell_branch import MaxwellBranch
from identifiability.joint.effects.nonlinear_tendon import NonlinearTendon
from identifiability.joint.effects.quadratic_stiffness import QuadraticStiffness
from identifiability.joint.effects.relaxation_spectrum import RelaxationSpectrum
from identifiability.joint.effects.second_mass import SecondMass
from identifiability.joint.effects.sensor_delay import SensorDelay
from identifiability.joint.effects.sensor_drift import SensorDrift
from identifiability.joint.effects.sensor_lowpass import SensorLowpass
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.effects.short_range_stiffness import ShortRangeStiffness
from identifiability.joint.effects.soft_coupling import SoftCoupling
from identifiability.joint.effects.stiffening_hysteresis import StiffeningHysteresis
from identifiability.joint.effects.stretch_reflex import StretchReflex

EFFECTS: dict[str, type[Effect]] = {
    effect.key: effect
    for effect in (
        SeriesTendon,
        NonlinearTendon,
        MaxwellBranch,
        ActivationLag,
        StretchReflex,
        HillForceVelocity,
        ShortRangeStiffness,
        QuadraticStiffness,
        CubicStiffness,
        CoulombFriction,
        Gravity,
        SecondMass,
        SensorDelay,
        SensorLowpass,
        SensorDrift,
        EndStop,
        DampingByAngle,
        DampingByDirection,
        SoftCoupling,
        Backlash,
    )
}

# Forms of which the library names no mechanism, so that one who finds them has found none of it.
DESCRIPTIONS: dict[str, type[Effect]] = {
    effect.key: effect for effect in (RelaxationSpectrum, StiffeningHysteresis)
}

__all__ = [
    "DESCRIPTIONS",
    "EFFECTS",
    "ActivationLag",
    "Backlash",
    "CoulombFriction",
    "CubicStiffness",
    "DampingByAngle",
    "DampingByDirection",
    "Effect",
    "EndStop",
    "Gravity",
    "HillForceVelocity",
    "MaxwellBranch",
    "Motion",
    "NonlinearTendon",
    "QuadraticStiffness",
    "RelaxationSpectrum",
    "SecondMass",
    "SensorDelay",
    "SensorDrift",
    "SensorLowpass",
    "SeriesTendon",
    "ShortRangeStiffness",
    "SoftCoupling",
    "StiffeningHysteresis",
    "StretchReflex",
]
