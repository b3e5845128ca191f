"""What a recording does not tell of an imposed motion between its samples."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import HELD, JOINT, trials

from identifiability.inference.likelihood.processes import Process, ProcessSum
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.investigation.posterior.search import weigh
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI

LIBRARY = {"second_mass": EFFECTS["second_mass"]}
FINE = np.arange(500) / 1000
KBI_OF = np.array([JOINT["K"], JOINT["B"], JOINT["I"]])


def sampled(every, noise=1e-3, seed=3):
    """Trials and held-out ones of K, B and I at 1,000 Hz over so many, their angle imposed."""
    random = np.random.default_rng(seed)
    parts = [
        trials(KBI(), JOINT, random, noise, conditions, "angle", time=FINE)
        for conditions in (None, HELD)
    ]
    return [
        [
            replace(t, time=t.time[::every], torque=t.torque[::every], angle=t.angle[::every])
            for t in part
        ]
        for part in parts
    ]


@pytest.mark.parametrize(("p", "q"), [(0, 0), (1, 0), (0, 2), (2, 1), (3, 3)])
def test_noise_of_its_own_size_in_every_sample_is_whitened_exactly(p, q):
    random, n = np.random.default_rng(1), 40
    ar, ma = np.array([1, -0.6, 0.2, -0.1])[: p + 1], np.array([1, 0.5, 0.3, 0.1])[: q + 1]
    noise = ProcessSum([Process(ar, ma, 0.7), Process(np.ones(1), np.array([1, -1.5, 0.7]), 0.3)])
    beside = np.where(random.random(n) < 0.4, 5 * random.random(n), 0.0)
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    covariance = sum(part.autocovariance(n - 1)[lag] for part in noise.parts) + np.diag(beside)
    whitening = noise.whitening(n, beside)
    white = whitening(np.eye(n))
    assert white @ covariance @ white.T == pytest.approx(np.eye(n), abs=1e-9)
    assert whitening.log_determinant(n) == pytest.approx(np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("every", [2, 4, 5])
def test_the_error_at_corners_is_of_the_size_that_is_expected(every):
    fitted, held = sampled(every, noise=1e-7)
    band = band_of(fitted, held)
    problem = band.problem(KBI())
    rows = problem.by_observation(problem.residuals(problem.free_vector(JOINT))[:, None])
    for row, variance in zip(band.stretches(rows), band.between(KBI_OF), strict=True):
        error, sd = row[:, 0] - np.median(row), np.sqrt(variance)
        assert np.max(np.abs(error)) < 3 * sd.max()
        # Not far less either, and nowhere where the motion is smooth or the joint at rest.
        assert np.max(np.abs(error)) > 0.1 * sd.max()
        assert np.sqrt(np.mean(error[sd == 0] ** 2)) < 0.05 * np.sqrt(np.mean(error**2))


def test_noise_alone_is_not_taken_for_corners():
    random = np.random.default_rng(2)
    fitted, held = sampled(1)
    # A slow motion, of which 1,000 Hz leaves nothing out.
    slow = [
        replace(
            t,
            angle=0.1 * np.sin(2 * np.pi * 2 * t.time + i),
            torque=3 * np.sin(2 * np.pi * 2 * t.time + i + 0.3),
        )
        for i, t in enumerate([*fitted, *held])
    ]
    noisy = [
        replace(
            t,
            torque=t.torque + 0.1 * random.standard_normal(t.n_samples),
            angle=t.angle + 1e-4 * random.standard_normal(t.n_samples),
        )
        for t in slow
    ]
    found = np.concatenate(band_of(noisy, []).between(KBI_OF))
    assert np.mean(found > 0) < 0.1


def test_a_perfect_joint_moved_with_corners_misses_nothing():
    study = Investigation(*sampled(4), library=LIBRARY)
    assert study.claim(study.weigh()).kind == "nothing"
    # The control: with the motion between the samples taken for known, it does.
    band = replace(band_of(*sampled(4)), changed=())
    evaluator = evaluator_of(band, study.baseline.values)
    found = weigh(evaluator, study.baseline, LIBRARY, 2)
    assert study.claim(found).kind in ("effects", "unknown")


@pytest.mark.long
def test_an_effect_is_found_beside_corners():
    model = KBI() + EFFECTS["second_mass"]()
    values = JOINT | {"second_mass.inertia": 0.03, "second_mass.frequency": 8.0}
    values |= {
        n: p for n, p in zip(model.parameter_names, model.nominal, strict=True) if n not in values
    }
    parts = []
    for seed, conditions in ((3, None), (4, HELD)):
        whole = trials(model, values, seed, conditions=conditions, driven="angle", time=FINE)
        parts.append([t.decimate(4) for t in whole])
    study = Investigation(*parts, library=LIBRARY)
    assert study.claim(study.weigh()).sets == (("second_mass",),)
