"""The likelihood of noisy recordings: exact where that can be checked, and covering where not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from scipy import signal

from identifiability.benchmark import coverage, noisy_recordings
from identifiability.inference import evaluation
from identifiability.inference.curvature import curvature
from identifiability.inference.fitting import fit
from identifiability.inference.likelihood import carried, coloured
from identifiability.inference.likelihood.estimate import (
    Contender,
    NoiseEstimate,
    Order,
    Stretch,
    _Sample,
    contenders,
    estimate_noise,
)
from identifiability.inference.likelihood.processes import Process, ProcessSum
from identifiability.inference.likelihood.profiled import (
    Residuals,
    change_of,
    least_squares,
    scaled_residuals,
)
from identifiability.inference.recordings import fit_with_noise
from identifiability.measurement.perturbations import imposed_motion
from identifiability.measurement.prepared import prepare_whole_band
from identifiability.measurement.trials import Trial

WHITE = Process(np.ones(1), np.ones(1), 1.0)
OWN = Process(np.array([1.0, -1.5, 0.7]), np.array([1.0, 0.4, 0.2]), 0.7)
CARRIED = Process(np.array([1.0, -0.9]), np.array([0.2, -1.0, 0.5, 0.1]), 1.3)


def spectral_covariance(n, *processes):
    """Covariance matrix by an integral over the spectrum."""
    z = np.exp(-2j * np.pi * np.arange(8192) / 8192)
    density = sum(
        p.sd**2 * np.abs(np.polyval(p.ma[::-1], z) / np.polyval(p.ar[::-1], z)) ** 2
        for p in processes
    )
    return scipy.linalg.toeplitz(np.fft.ifft(density).real[:n])


@pytest.mark.parametrize(
    "processes", [(OWN,), (CARRIED,), (OWN, CARRIED), (Process(np.ones(1), np.ones(1), 2.0),)]
)
@pytest.mark.parametrize("n", [3, 60])
def test_whitening_is_that_of_the_covariance(processes, n):
    covariance = spectral_covariance(n, *processes)
    whitening = ProcessSum(processes).whitening(n)
    white = whitening(np.eye(n))
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(n), atol=1e-9)
    _, log_determinant = np.linalg.slogdet(covariance)
    assert whitening.log_determinant(n) == pytest.approx(log_determinant, abs=1e-8)


def test_a_long_record_is_whitened_as_a_short_one_would_be():
    noise = ProcessSum((OWN, CARRIED))
    values = np.random.default_rng(1).standard_normal((2500, 1))
    long = noise.whitening(2500)(values)
    covariance = spectral_covariance(2500, OWN, CARRIED)
    factor = np.linalg.cholesky(covariance)
    np.testing.assert_allclose(
        long[:, 0], scipy.linalg.solve_triangular(factor, values[:, 0], lower=True), atol=1e-8
    )


STRETCHES = [[np.arange(5, 45), np.arange(50, 80)], [np.arange(60)]]


def whitened(colour, residual, joint):
    """What is left of two trials of 90 samples, with derivatives by K, B and I."""
    nothing = np.zeros(90)
    fields = ("measured", "scale", "carry", "constant")
    one = SimpleNamespace(**dict.fromkeys(fields, nothing), previous=nothing.astype(int))
    what = evaluation.compared([one, one], [one.previous] * 2, 0, colour)
    what = what._replace(columns=residual.shape[2])
    found = np.zeros((what.n_rows, what.columns))
    products, flat = np.zeros((what.columns,) * 2), residual.reshape(180, -1)
    evaluation._compare(flat, what, joint, np.array([1, 2, 3]), found, products)
    np.testing.assert_allclose(products, found.T @ found, rtol=1e-12)
    return found


def test_residuals_of_trials_are_whitened_by_the_covariance():
    noise = NoiseEstimate(OWN, CARRIED, np.array([1.0, 2.0]), 1.0, 1, True)
    colour = coloured.Colour([noise], [0, 0], [0, 1], STRETCHES, None, np.ones(3))
    residual = np.random.default_rng(2).standard_normal((2, 90, 4))
    found, done = whitened(colour, residual, np.ones(3)), 0
    for row, level in enumerate((1.0, 2.0)):
        for samples in STRETCHES[row]:
            factor = np.linalg.cholesky(spectral_covariance(samples.size, OWN, CARRIED))
            white = np.linalg.solve(factor, residual[row, samples]) / level
            constant = np.linalg.solve(factor, np.ones(samples.size))
            constant /= np.linalg.norm(constant)
            expected = white - np.outer(constant, constant @ white)
            np.testing.assert_allclose(found[done : done + samples.size], expected, atol=1e-8)
            done += samples.size
    assert done == len(found)


@pytest.mark.parametrize("ceiling", [1.0, 0.1], ids=["left", "nothing left"])
def test_noise_of_the_angle_is_taken_off_with_its_derivatives(ceiling):
    random = np.random.default_rng(3)
    noise = NoiseEstimate(OWN, CARRIED, np.array([1.0, 2.0]), 1.0, 1, True)
    excess, joint = np.diag([1.0, 2.0, 3.0]) + 0.2, np.array([1.0, 0.5, 0.2])
    colour = coloured.Colour([noise], [0, 0], [0, 1], STRETCHES, excess, ceiling * joint)
    both = random.standard_normal((2, 90, 4))

    def moved(by):
        at = both.copy()
        at[:, :, 0] += both[:, :, 1:] @ by
        return whitened(colour, at, joint + by)

    found, left = moved(np.zeros(3)), 4 * ceiling**2 * joint @ excess @ joint
    left = max(left - joint @ excess @ joint, 1e-6 * left)
    assert found[-1, 0] == pytest.approx(np.sqrt(left), rel=1e-12)
    for i, step in enumerate(1e-5 * np.eye(3)):
        expected = (moved(step)[:, 0] - moved(-step)[:, 0]) / 2e-5
        np.testing.assert_allclose(found[:, 1 + i], expected, rtol=1e-6, atol=1e-7)


def restricted_cost(values, stretches, carried):
    """Minus the restricted log likelihood, but for a constant, of ARMA(1, 1) and what came in."""
    partial = np.tanh(values[:2])
    own = Process(np.array([1.0, partial[0]]), np.array([1.0, partial[1]]))
    came_in = Process(*carried, np.exp(values[2]))
    roots, determinant = [], 0.0
    for residual, _ in stretches:
        root = np.linalg.cholesky(spectral_covariance(residual.size, own, came_in))
        roots.append(root)
        determinant += 2 * np.sum(np.log(np.diag(root)))
    white = np.concatenate(
        [np.linalg.solve(root, r) for root, (r, _) in zip(roots, stretches, strict=True)]
    )
    level = scipy.linalg.block_diag(
        *[np.linalg.solve(root, np.ones((len(root), 1))) for root in roots]
    )
    shape = np.concatenate(
        [np.linalg.solve(root, j) for root, (_, j) in zip(roots, stretches, strict=True)]
    )
    taken = np.column_stack([level, shape])
    # The fit has taken its share of the residual already: only levels are left to fit.
    left = white - level @ np.linalg.lstsq(level, white, rcond=None)[0]
    determinant += np.linalg.slogdet(taken.T @ taken)[1]
    freedom = white.size - taken.shape[1]
    return 0.5 * freedom * np.log(left @ left / freedom) + 0.5 * determinant


def test_the_sum_of_squares_is_the_restricted_likelihood():
    random = np.random.default_rng(4)
    lengths, numbers, k = np.array([40, 60]), np.array([2, 1]), 2
    stretches = [
        (random.standard_normal(n), np.cumsum(random.standard_normal((n, k)), axis=0))
        for n in np.repeat(lengths, numbers)
    ]
    columns = [
        np.column_stack([*(r for r, _ in those), *(j for _, j in those)]).ravel()
        for those in (stretches[:2], stretches[2:])
    ]
    carried = np.array([1.0, -0.6]), np.array([0.4, 0.3])
    sought_in = Residuals(1, 1, carried, np.concatenate(columns), lengths, numbers, k)
    values = np.array([-0.5, 0.3, -0.4])
    other = np.array([-1.2, 0.1, 0.6])

    def cost(values):
        scaled, freedom = scaled_residuals(values, sought_in)
        return 0.5 * freedom * np.log(scaled @ scaled / freedom)

    assert cost(other) - cost(values) == pytest.approx(
        restricted_cost(other, stretches, carried) - restricted_cost(values, stretches, carried),
        abs=1e-6,
    )
    step = 1e-6
    full = np.column_stack(
        [
            (
                scaled_residuals(values + step * axis, sought_in)[0]
                - scaled_residuals(values - step * axis, sought_in)[0]
            )
            / (2 * step)
            for axis in np.eye(3)
        ]
    )
    here = scaled_residuals(values, sought_in)[0]
    gradient, products = change_of(values, here, sought_in, 3)
    np.testing.assert_allclose(products, full.T @ full, rtol=1e-4)
    np.testing.assert_allclose(gradient, here @ full, rtol=1e-3)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_the_noise_that_is_found_is_the_most_likely(colour, held):
    random = np.random.default_rng(7)
    joint, interval, n = np.array([40.0, 0.5, 0.05]), 0.002, 300
    came_in = carried.by_impedance(joint, interval)
    came_in = Process(came_in.ar, came_in.ma, 1 / np.sqrt(came_in.autocovariance(0)[0]))
    own = Process(np.array([1.0, -colour]), np.array([1.0, 0.3]), 1.0)
    columns = np.column_stack([own.draw(n, random) + 0.5 * came_in.draw(n, random) for _ in "ab"])
    carries = came_in.ar, came_in.sd * came_in.ma
    sought_in = Residuals(1, 1, carries, columns.ravel(), np.array([n]), np.array([2]), 0)
    start = np.array([-0.5, 0.0, -1.0])
    n_free = 3 - held
    bounds = np.full(n_free, -5.0), np.full(n_free, 5.0)

    def cost(values):
        scaled, freedom = scaled_residuals(values, sought_in)
        return 0.5 * freedom * np.log(scaled @ scaled / freedom)

    found, ended = least_squares(start, sought_in, *bounds)
    best = scipy.optimize.minimize(
        lambda free: cost(np.append(free, start[n_free:])), start[:n_free], method="Nelder-Mead"
    )
    assert ended
    np.testing.assert_array_equal(found[n_free:], start[n_free:])
    assert cost(start) - cost(found) > 10
    assert cost(found) == pytest.approx(best.fun, abs=0.01)


def test_a_noise_is_sought_within_bounds():
    random = np.random.default_rng(8)
    columns = np.cumsum(random.standard_normal(400))
    sought_in = Residuals(
        1, 0, (np.ones(1), np.zeros(1)), columns, np.array([400]), np.array([1]), 0
    )
    bounds = np.array([-1.0]), np.array([1.0])
    found, ended = least_squares(np.array([0.5]), sought_in, *bounds)
    assert ended
    assert found[0] == -1.0


def carried_noises(share, draws, own=WHITE, known=0.0):
    """Estimates of noise with so much of it carried, and what each should have found."""
    interval = 0.01
    came_in = carried.by_impedance(np.array([40.0, 0.5, 0.05]), interval)
    unit = 1 / np.sqrt(came_in.autocovariance(0)[0])
    through = Process(came_in.ar, came_in.ma, share * unit)
    orders = [Contender(Order(own.ar.size - 1, 0, True))]
    for seed in range(draws):
        random = np.random.default_rng(seed)
        residual = own.draw(400, random) + through.draw(400, random)
        stretch = Stretch(residual, np.linspace(-1, 1, 400)[:, None], 0)
        yield estimate_noise([stretch], came_in, orders, known, with_error=True)[0], share * unit


def test_how_well_carried_noise_is_known_is_its_scatter():
    """The variance of what came in is off by its stated error."""
    for share in (1.0, 2.0):
        off = []
        for estimate, sd in carried_noises(share, 40):
            variance = estimate.carried_sd**2
            off.append((variance - sd**2) / (estimate.carried_error * variance))
        # 40 draws tell a standard deviation to an eighth of it; parabolas are not exact.
        assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_carried_noise_of_the_own_noise_s_colour_is_not_known():
    """Where there is none, next to nothing says how much there is; what is known has no error."""
    slow = Process(np.array([1.0, -0.99]), np.ones(1), 1.0)
    errors = [estimate.carried_error for estimate, _ in carried_noises(0.0, 10, slow)]
    assert np.median(errors) > 0.7
    sure = [estimate.carried_error for estimate, _ in carried_noises(5.0, 3, slow)]
    assert max(sure) < 0.3  # the control
    told = [estimate.carried_error for estimate, _ in carried_noises(0.0, 3, slow, known=1.0)]
    assert max(told) == 0


def test_carried_noise_is_that_of_the_response():
    joint, interval = np.array([40.0, 1.5, 0.05]), 0.004
    random = np.random.default_rng(3)
    angle = random.standard_normal(4000)
    torque = imposed_motion(interval * np.arange(4000), angle).signals @ joint
    expected = carried.by_impedance(joint, interval).autocovariance(3)
    inner = torque[50:-50]
    found = [np.mean(inner[: inner.size - lag] * inner[lag:]) for lag in range(4)]
    np.testing.assert_allclose(found, expected, atol=0.08 * expected[0])
    push = random.standard_normal(20000)
    system = signal.lti([1.0], [joint[2], joint[1], joint[0]])
    _, moved, _ = signal.lsim(system, push, interval * np.arange(push.size))
    assert np.var(moved[2000:]) == pytest.approx(
        carried.by_admittance(joint, interval).autocovariance(0)[0], rel=0.15
    )


@pytest.mark.parametrize("joint", [(80.0, 0.5, 0.02), (100.0, 1.0, 0.017), (1e3, 0.0, 1e-4)])
@pytest.mark.parametrize("interval", [0.001, 0.01])
def test_noise_of_an_imposed_angle_has_the_spectrum_of_its_spline(joint, interval):
    """A filter that looks back alone, and the spline, whose far samples are left out."""
    joint = np.array(joint)
    found = carried.by_impedance(joint, interval)
    spline = Process(np.ones(1), carried.motion_taps(interval) @ joint)
    scale = spline.autocovariance(0)[0]
    off = found.autocovariance(60) - spline.autocovariance(60)
    np.testing.assert_allclose(off / scale, 0.0, atol=1e-4)
    # A motion that stays is held by the stiffness alone.
    assert found.ma.sum() / found.ar.sum() == pytest.approx(joint[0], rel=1e-9)


def residuals_of(process, n, pieces, seed):
    random = np.random.default_rng(seed)
    slope = np.linspace(-1, 1, n)[:, None]
    return [Stretch(process.draw(n, random), slope, i) for i in range(pieces)]


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
def test_the_colour_is_found(rho):
    process = Process(np.array([1.0, -rho]), np.ones(1), 0.3)
    noise, _ = estimate_noise(residuals_of(process, 500, 6, 4), None, contenders(carried=(False,)))
    frequencies = np.exp(-2j * np.pi * np.array([0.01, 0.05, 0.2, 0.45]))

    def density(p):
        return np.abs(
            p.sd * np.polyval(p.ma[::-1], frequencies) / np.polyval(p.ar[::-1], frequencies)
        )

    np.testing.assert_allclose(density(noise.own), density(process), rtol=0.25)
    assert noise.converged


def left_by_a_poor_model(seed):
    rng = np.random.default_rng(seed)
    time = 0.002 * np.arange(400)
    left = []
    for length in rng.uniform(0.02, 0.2, 6):
        push = rng.uniform(1, 3) * ((time > 0.1) & (time < 0.1 + length))
        true, poor = (
            signal.lsim(([1.0], [0.1, damping, stiffness]), push, time)[1]
            for damping, stiffness in ((1.0, 30.0), (1.1, 33.0))
        )
        left.append(true - poor + 1e-5 * rng.standard_normal(400))
    size = np.std(left)
    stretches = [Stretch(one / size, np.zeros((400, 0)), i) for i, one in enumerate(left)]
    came_in = carried.by_admittance(np.array([30.0, 1.0, 0.1]), 0.002)
    came_in = replace(came_in, sd=1 / np.sqrt(came_in.autocovariance(0)[0]))
    return _Sample(stretches, came_in)


def test_noise_is_sought_from_two_colours():
    """From one alone the likeliest noise of what a poor model leaves is missed, here or there."""
    ahead = []
    for seed in range(1, 7):
        sample = left_by_a_poor_model(seed)

        def costs(order, sample=sample):
            fits = [sample.fitted(order, one, restricted=False) for one in sample.starts(order)]
            return [cost for _, cost, _ in fits]

        nearly_white, coloured = costs(Order(2, 1, True))
        ahead.append(coloured - nearly_white)
        nearly_white, coloured = costs(Order(3, 3, True))
        assert coloured < nearly_white - 100
        best = sample.ranked([Contender(Order(2, 1, True)), Contender(Order(3, 3, True))])[0]
        cost = sample.cost(best.order, best.values, restricted=False)
        assert cost == pytest.approx(coloured)
    # A descent ends here or there by its rounding, which differs between processors.
    assert max(ahead) > 10


def test_restricted_likelihood_does_not_make_slow_noise_faster():
    """Plain likelihood takes what levels and slopes absorb for absent: the control."""
    process = Process(np.array([1.0, -0.99]), np.ones(1), 1.0)
    found = []
    for seed in range(20):
        stretches = residuals_of(process, 120, 6, 100 + seed)
        noise, _ = estimate_noise(stretches, None, contenders(carried=(False,))[1:2])
        centred = np.concatenate([s.residual - s.residual.mean() for s in stretches])
        plain = centred[1:] @ centred[:-1] / (centred @ centred)
        found.append((-noise.own.ar[1], plain))
    restricted, plain = np.mean(found, axis=0)
    assert abs(restricted - 0.99) < 0.006
    assert plain < 0.975


def test_parameters_that_do_the_same_leave_the_noise_as_it_is():
    """A determinant of derivatives that repeat each other is rounding, and no likelihood."""
    rng = np.random.default_rng(4)
    motion, other = rng.standard_normal((2, 400)).cumsum(axis=1)
    noise = Process(np.array([1.0, -0.8]), np.ones(1)).draw(400, rng)

    def estimated(*derivatives):
        stretch = Stretch(noise, np.column_stack(derivatives), 0)
        return estimate_noise([stretch], None, contenders(carried=(False,)))[0]

    once, twice = estimated(motion, other), estimated(motion, other, 3e4 * motion)
    np.testing.assert_allclose(twice.own.ar, once.own.ar, atol=1e-6)
    assert twice.own.sd == pytest.approx(once.own.sd, rel=1e-6)


def test_trials_that_differ_in_level_are_told_apart():
    random = np.random.default_rng(6)
    levels = (1.0, 1.0, 4.0)
    stretches = [
        Stretch(level * random.standard_normal(400), np.ones((400, 1)) * np.arange(400)[:, None], i)
        for i, level in enumerate(levels)
    ]
    noise, _ = estimate_noise(stretches, None, contenders(carried=(False,)))
    assert noise.levels[2] / noise.levels[0] == pytest.approx(4, rel=0.15)
    alike = [
        Stretch(s.residual / level, s.jacobian, s.trial)
        for s, level in zip(stretches, levels, strict=True)
    ]
    noise, _ = estimate_noise(alike, None, contenders(carried=(False,)))
    assert np.ptp(noise.levels) == 0


def servo(angle_noise, seed, rate=500, duration=0.8, trials=6):
    """Trials of a joint whose angle is imposed, and its K, B and I."""
    random = np.random.default_rng(seed)
    joint = np.array([30.0, 1.2, 0.1])
    found = []
    for i in range(trials):
        time = np.arange(0, duration, 1 / rate)
        torque, angle = noisy_recordings._moved(joint, time, random)
        torque = torque + 0.01 * random.standard_normal(time.size)
        angle = angle + angle_noise * random.standard_normal(time.size)
        found.append(Trial(time, torque, angle, driven="angle", name=str(i)))
    return found, joint


def test_noise_of_an_imposed_angle_does_not_make_the_inertia_too_small():
    """The same weights without the correction are the control: they do make it too small."""
    mended, plain = [], []
    for seed in range(4):
        trials, joint = servo(3e-4, seed, rate=200, duration=20, trials=1)
        noisy = fit_with_noise(trials)
        assert noisy.settled
        assert noisy.corrected
        # White noise that is thinned keeps its density.
        thinned = noisy.problem.interval / trials[0].dt
        assert noisy.noises[0].carried_sd * np.sqrt(thinned) == pytest.approx(3e-4, rel=0.1)
        sd = np.sqrt(np.diag(curvature(noisy.problem, noisy.fit.values).covariance))
        mended.append((noisy.fit.values - joint) / sd)
        uncorrected = replace(noisy.problem, colour=replace(noisy.problem.colour, excess=None))
        plain.append((fit(uncorrected, noisy.fit.values[None]).values - joint) / sd)
    assert np.all(np.abs(np.mean(mended, axis=0)) < 3.5 / np.sqrt(4))
    assert np.mean(plain, axis=0)[2] < -2


def test_result_hardly_depends_on_how_far_a_recording_is_thinned():
    trials, _ = servo(1e-4, 20, rate=1000)
    found = []
    for lowpass_hz in (30.0, 60.0):
        whole_band = prepare_whole_band(trials, lowpass_hz=lowpass_hz)
        assert whole_band[0].interval > trials[0].dt
        found.append(fit_with_noise(trials, lowpass_hz=lowpass_hz))
    first, second = found
    sd = np.sqrt(np.diag(curvature(first.problem, first.fit.values).covariance))
    assert np.all(np.abs(first.fit.values - second.fit.values) < 2 * sd)


def test_unequal_rates_and_levels_are_fitted_together():
    slow, joint = servo(0.0, 30, rate=200)
    fast, _ = servo(0.0, 31, rate=500)
    noisy = fit_with_noise([*slow[:3], *fast[:3]])
    assert len(noisy.noises) == 2
    sd = np.sqrt(np.diag(curvature(noisy.problem, noisy.fit.values).covariance))
    assert np.all(np.abs(noisy.fit.values - joint) < 4 * sd)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "imposed"),
    [("AR 0.99", "torque"), ("both channels", "angle")],
)
def test_errors_are_of_the_stated_size(kind, imposed):
    """Squared errors in stated widths are those of a Gaussian, within Monte Carlo error."""
    found = coverage.errors(coverage.Task(kind, imposed, 77, 0, 4))
    scaled = found["error"] / found["sd"]
    assert np.all(np.isfinite(scaled))
    # Twelve numbers, three of each recording correlated: bounds of a chi square of half as many.
    assert 0.1 < np.mean(scaled**2) < 3.7


@pytest.mark.long
@pytest.mark.parametrize("imposed", ["torque", "angle"])
@pytest.mark.parametrize("kind", coverage.KINDS)
def test_intervals_cover(kind, imposed):
    """Coverage of a fresh seed is within what 40 recordings can tell of the mark."""
    found = coverage.errors(coverage.Task(kind, imposed, 177, 0, 40))
    covered = np.mean(np.abs(found["error"] / found["sd"]) < 1.96, axis=0)
    chance = 2.6 * np.sqrt(0.05 * 0.95 / 40)
    assert np.all(covered > coverage.MARK[0] - chance)


def test_a_recording_comes_from_its_seed():
    for imposed in ("torque", "angle"):
        seed = np.random.SeedSequence([1, 2])
        first, _ = noisy_recordings.recording("encoder", imposed, seed)
        second, _ = noisy_recordings.recording("encoder", imposed, np.random.SeedSequence([1, 2]))
        assert all(
            np.array_equal(a.angle, b.angle) and np.array_equal(a.torque, b.torque)
            for a, b in zip(first, second, strict=True)
        )
