"""How much less than a model amplifies of an angle's noise a record may have of it by chance.

Noise of an imposed angle adds to what a model leaves, the more the model amplifies it, and that is
taken off. It is right on average, and scatters: a model that resonates finds a frequency at which
the noise happens to be weak, takes off what is not there, and seems likelier.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_SMOOTHED = 10  # frequencies to each side over which the usual share of the noise is averaged


def scatter(probe: np.ndarray, usual: np.ndarray, sizes: Sequence[int]) -> float:
    r"""Standard deviation by which a model makes the sum of squares scatter more.

    Of whitened Gaussian noise with the spectrum c the sum of squares has the variance
    :math:`2 \sum c^2`. With a share s of the angle's noise it is 1; a model that makes r of s makes
    it :math:`c = 1 - s + r`. Of a draw the periodogram P has the mean r, and its square
    :math:`2 r^2`, but at the ends of the spectrum :math:`3 r^2`.

    Parameters
    ----------
    probe, usual : array, shape (n,)
        What a draw of the noise adds to the whitened residual of the model, and of the reference.
    sizes : sequence of int
        Of the stretches, one after the other.
    """
    extra, first = 0.0, 0
    for n in sizes:
        here, there = probe[first : first + n], usual[first : first + n]
        first += n
        drawn, usually = (np.abs(np.fft.rfft(one)) ** 2 / n for one in (here, there))
        rest = 1 - np.minimum(_averaged(usually), 1.0)
        freedoms, fourth = np.full(drawn.size, 2.0), np.full(drawn.size, 2.0)
        ends = [0, -1] if n % 2 == 0 else [0]
        freedoms[ends], fourth[ends] = 1.0, 3.0
        squared = rest**2 + 2 * rest * drawn + drawn**2 / fourth
        extra += 2 * float(np.sum(freedoms * (squared - 1)))
    return float(np.sqrt(max(extra, 0.0)))


def _averaged(values: np.ndarray) -> np.ndarray:
    m = min(_SMOOTHED, values.size - 1)
    window = np.full(2 * m + 1, 1 / (2 * m + 1))
    return np.convolve(np.pad(values, m, mode="reflect"), window, mode="valid")
