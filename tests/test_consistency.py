"""Whether K, B and I are the same however they are fitted, and what `fit` says of it."""

from types import SimpleNamespace

import pytest
from hidden import JOINT, trials

from identifiability.inference.consistency import consistency
from identifiability.inference.recordings import fit_recordings
from identifiability.joint.model import KBI
from identifiability.report.fit import answer, structural

UNITS = {"K": "Nm/rad", "B": "Nms/rad", "I": "kg m²"}


def widths_of(values, sd=1.0, verdict="agrees"):
    rows = [
        SimpleNamespace(name=n, unit=u, optimum=v, posterior_sd=sd, profile=9 * sd, verdict=verdict)
        for (n, u), v in zip(UNITS.items(), values, strict=True)
    ]
    return SimpleNamespace(rows=rows)


def fitted(whole, least, windows=(), **options):
    """A fit that is made up: values of whole records, least squares, and by window."""
    return SimpleNamespace(
        widths=widths_of(whole, **options),
        least_squares=dict(zip(UNITS, least, strict=True)),
        windows=[
            SimpleNamespace(window=T, widths=widths_of(values, **options)) for T, values in windows
        ],
    )


@pytest.mark.parametrize(
    ("result", "kind", "named"),
    [
        (fitted((30, 1, 1), (31, 1, 1)), "not tested", []),
        (fitted((30, 1, 1), (34, 1, 1)), "depends on the weights", ["K"]),
        (fitted((30, 1, 1), (30, 1, 1), [(0.1, (32, 1, 1))]), "the same", []),
        (fitted((30, 1, 1), (30, 1, 1), [(0.1, (35, 1, 1))]), "depends on the window", ["K"]),
        # Between windows as well as against whole records.
        (
            fitted((30, 5, 1), (30, 5, 1), [(0.1, (32.5, 5, 1)), (0.2, (27.5, 1, 1))]),
            "depends on the window",
            ["K"],
        ),
        # Sampling that did not converge has the profile's width.
        (
            fitted((30, 1, 1), (30, 1, 1), [(0.1, (35, 1, 1))], verdict="not converged"),
            "the same",
            [],
        ),
    ],
)
def test_what_differs_by_more_than_the_noise_is_named(result, kind, named):
    found = consistency(result)
    assert found.kind == kind
    assert [one.name for one in found.notable] == named
    assert ("not a property of this joint" in answer(found)) == bool(named)


def test_the_answer_says_from_what_to_what():
    result = fitted((28, 1, 1), (28, 1, 1), [(0.1, (40, 1, 1)), (0.2, (28, 8, 1))])
    assert answer(consistency(result)).startswith(
        "K falls from 40.0 ± 1.0 Nm/rad to 28.0 ± 1.0 Nm/rad as the window grows from 100 ms to "
        "200 ms: it is not a property of this joint. Neither is B."
    )


def test_a_structural_error_is_what_noise_leaves_of_a_difference():
    windows = [(0.1, (36, 3, 1))]
    K, B, I = consistency(fitted((30, 1, 1), (30, 1, 9), windows)).structural
    # Each window has a variance of 1: two of the squared difference of 6 are noise.
    assert (K.width, K.error) == (1, pytest.approx(34**0.5))
    assert (B.unit, B.error) == ("Nms/rad", 0)
    # Least squares are of the same samples.
    assert pytest.approx(63**0.5) == I.error
    said = structural(consistency(fitted((30, 1, 1), (30, 1, 9), windows)))
    assert said == "K 1 and 5.8 Nm/rad, B 1 Nms/rad and none seen, I 1 and 7.9 kg m²"


@pytest.mark.long
@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_joint_that_is_K_B_and_I_has_the_same_in_every_window(driven):
    windows = (0.1, 0.2) if driven == "torque" else (0.2,)
    result = fit_recordings(trials(KBI(), JOINT, driven=driven), window_lengths=windows)
    assert consistency(result).kind == "the same"
