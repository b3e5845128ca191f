"""Pieces of a long record are what the whole record is, however long its joint swings on."""

from dataclasses import replace

import numpy as np
import pytest

from identifiability.investigation.pieces import pieces, remembering
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.split import gather
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.prepared import prepare_whole_band
from identifiability.measurement.trials import Trial

TIME = np.arange(12000) / 1000
SWINGING = {"K": 11.2, "B": 0.25, "I": 0.054}  # damped by a sixth: 2.3 /s
SLOW = {"K": 20.0, "B": 1.0, "I": 0.05, "maxwell_branch.stiffness": 15.0}


def pushed(seed=3, noise=1e-3):
    """Random steps of torque."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-1, 1, 80), 150)
    torque[:300] = 0.0
    drive = SampledTorque(torque).drive(TIME)
    angle = simulate(KBI(), KBI().vector(SWINGING), drive)
    angle += noise * np.std(angle) * rng.standard_normal(TIME.size)
    return Trial(TIME, torque, angle, name="pushed"), KBI(), SWINGING


def turned(seed=3, noise=1e-3):
    """A slowly relaxing joint, turned smoothly to and fro."""
    rng = np.random.default_rng(seed)
    waves = sum(
        rng.uniform(0.5, 1) * np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6))
        for f in (0.4, 0.9, 1.7, 3.1)
    )
    angle = 0.05 * waves * np.clip(TIME / 0.5, 0, 1) ** 3
    model = KBI() + EFFECTS["maxwell_branch"]()
    values = SLOW | {"maxwell_branch.time_constant": 0.25}
    torque = simulate(model, model.vector(values), imposed_motion(TIME, angle))
    torque += noise * np.std(torque) * rng.standard_normal(TIME.size)
    return Trial(TIME, torque, angle, driven="angle", name="turned"), model, values


def gap(prepared, model, values):
    """Largest difference of its pieces' responses from that of the whole, over the response."""
    theta = model.vector(values)
    whole = simulate(model, theta, prepared.drive)
    at, most = prepared.first, 0.0
    for one in pieces(prepared, Noise(1.0)):
        chosen = np.flatnonzero(one.scale > 0)
        part = simulate(model, theta, one.drive)[chosen]
        most = max(most, float(np.abs(part - whole[at : at + chosen.size]).max()))
        at += chosen.size
    assert at == prepared.last
    return most / float(np.std(whole))


@pytest.mark.parametrize("recorded", [pushed, turned])
def test_pieces_are_the_whole(recorded):
    trial, model, values = recorded()
    (ready,) = remembering(prepare_whole_band([trial], lowpass_hz=None))
    assert len(pieces(ready, Noise(1.0))) > 1
    assert gap(ready, model, values) < 1e-4
    # A second, for every joint, is too short.
    assert gap(replace(ready, warm_up=1.0), model, values) > 1e-3


def test_a_joint_that_forgets_soon_is_computed_no_longer():
    trial, _, _ = pushed()
    quick = simulate(
        KBI(),
        KBI().vector({"K": 50.0, "B": 2.0, "I": 0.02}),
        SampledTorque(trial.torque).drive(TIME),
    )
    rng = np.random.default_rng(1)
    noisy = quick + 1e-3 * np.std(quick) * rng.standard_normal(quick.size)
    (ready,) = remembering(prepare_whole_band([Trial(TIME, trial.torque, noisy)]))
    assert ready.warm_up == 1.0


@pytest.mark.parametrize("recorded", [pushed, turned])
def test_fits_and_likelihood_both_know(recorded):
    trial, model, values = recorded()
    split = gather([trial], lowpass_hz=None)
    for ready in (*split.fitted, *split.held_out, *band_of([trial], []).prepared):
        assert ready.warm_up > 2.5
        assert gap(ready, model, values) < 1e-4


def test_of_a_joint_that_swings_on_no_more_is_computed_than_twice_what_is_compared():
    """What precedes a piece is computed again for each: short ones would be mostly that."""
    trial, _, _ = pushed()
    (ready,) = prepare_whole_band([trial])
    swinging = replace(ready, warm_up=20.0)
    sizes = [o.measured.size for o in pieces(swinging, Noise(1.0))]
    assert len(sizes) > 1
    assert sum(sizes) < 2 * TIME.size
    # Few of short ones, to begin fits by, are quicker all the same.
    assert max(o.measured.size for o in pieces(swinging, Noise(1.0), shortly=True)[:2]) <= 4096
