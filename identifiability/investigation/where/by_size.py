"""Whether the misfit turns its sign, and whether it grows, with the perturbation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.investigation.where.compare import plain, probability
from identifiability.investigation.where.scene import Scene, View, bin_of, misfit, time_edges
from identifiability.investigation.where.whitening import Portion, excess

_OPPOSITE, _OTHER_SIZE = 0.05, 1.2  # how close to -1, and how far from 1, the ratio of sizes is


@dataclass(frozen=True, eq=False)
class DirectionView(View):
    """Parts of the residual that keep and that turn their sign with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        Trials of one perturbation and its opposite.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    even, odd : array, shape (n,)
        Mean square over that of the noise.
    p_even, p_odd : float
    even_significant, odd_significant : bool
    """

    pairs: tuple[tuple[str, str], ...]
    edges: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    p_even: float
    p_odd: float
    even_significant: bool
    odd_significant: bool


@dataclass(frozen=True, eq=False)
class AmplitudeView(View):
    """The part of the residual that does not scale with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        The smaller and the larger of two perturbations of one waveform.
    gains : tuple of float
        Ratio of their sizes.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    ratio : array, shape (n,)
        Mean square of larger less scaled smaller residual, over that of the noise.
    p_value : float
    """

    pairs: tuple[tuple[str, str], ...]
    gains: tuple[float, ...]
    edges: np.ndarray
    ratio: np.ndarray
    p_value: float


@dataclass(frozen=True, eq=False)
class _Combined:
    """Weighted sum of two trials' residuals, in units of its noise."""

    values: np.ndarray
    time: np.ndarray
    portion: Portion


def _combined(scene: Scene, i: int, j: int, weight: float) -> _Combined:
    """Residual of trial j plus `weight` times that of trial i."""
    one, other = scene.blocks[i], scene.blocks[j]
    n = min(one.values.size, other.values.size)
    variances = np.array([(weight * scene.noise.sds[i]) ** 2, scene.noise.sds[j] ** 2])
    total = variances.sum()
    values = (
        weight * scene.noise.sds[i] * one.values[:n] + scene.noise.sds[j] * other.values[:n]
    ) / np.sqrt(total)
    shares = variances / total
    levels = np.array([one.level[:n] @ one.level[:n], other.level[:n] @ other.level[:n]])
    dof = 1 / np.sum(shares**2 / scene.noise.dof[[i, j]])
    return _Combined(values, other.time[:n], Portion(n, float(shares @ levels), float(dof)))


def _profile(
    scene: Scene, combined: Sequence[_Combined], edges: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Mean squares over the noise's by time; the ratio over all times, and its probability."""
    bins = [bin_of(c.time, edges) for c in combined]
    squares = np.zeros(edges.size - 1)
    numbers = np.zeros(edges.size - 1)
    for c, inside in zip(combined, bins, strict=True):
        squares += np.bincount(inside, c.values**2, edges.size - 1)
        numbers += np.bincount(inside, minlength=edges.size - 1)
    total = sum(float(c.values @ c.values) for c in combined)
    ratio, p_value = excess(total, [c.portion for c in combined], scene.slack)
    return squares / np.maximum(numbers, 1), ratio, p_value


def _alike(scene: Scene) -> list[tuple[int, int, float]]:
    """Pairs of trials of one waveform and length, the smaller first, and the ratio of sizes."""
    found = []
    for i, one in enumerate(scene.loads):
        for j, other in enumerate(scene.loads):
            ratio = other.gain / one.gain if one.gain else 0.0
            same = i != j and one.kind == other.kind and scene.blocks[i].time.size > 0
            if same and (abs(ratio) > 1 or (abs(ratio) == 1 and i < j)):
                found.append((i, j, ratio))
    return found


def _names(scene: Scene, pairs: Sequence[tuple[int, int, float]]) -> tuple[tuple[str, str], ...]:
    return tuple((scene.parts[i].name, scene.parts[j].name) for i, j, _ in pairs)


def by_direction(scene: Scene) -> DirectionView:
    """Split the misfit of opposite trials into parts that keep and that turn their sign."""
    pairs = [p for p in _alike(scene) if abs(p[2] + 1) < _OPPOSITE]
    if not pairs:
        none = np.zeros(0)
        reason = (
            "No two trials are the same perturbation in opposite directions, so the misfit cannot "
            "be split into parts that keep and that turn their sign."
        )
        return DirectionView(False, reason, (), none, none, none, 1.0, 1.0, False, False)
    even = [_combined(scene, i, j, 1.0) for i, j, _ in pairs]
    odd = [_combined(scene, i, j, -1.0) for i, j, _ in pairs]
    edges = time_edges(scene, {k for i, j, _ in pairs for k in (i, j)})
    even_profile, even_ratio, p_even = _profile(scene, even, edges)
    odd_profile, odd_ratio, p_odd = _profile(scene, odd, edges)
    is_even, is_odd = (bool(f) for f in scene.significant(np.array([p_even, p_odd])))
    sizes = (
        f"(even part {plain(np.sqrt(even_ratio))}, odd part {plain(np.sqrt(odd_ratio))} times "
        f"{scene.reference})"
    )
    sentence = {
        (False, False): f"Neither direction shows a misfit {sizes}.",
        (False, True): f"The misfit turns its sign with the perturbation {sizes}.",
        (True, False): f"The misfit keeps its sign when the perturbation turns {sizes}.",
        (
            True,
            True,
        ): f"The misfit differs between the directions, and partly turns with them {sizes}.",
    }[is_even, is_odd]
    return DirectionView(
        is_even or is_odd,
        sentence,
        _names(scene, pairs),
        edges,
        even_profile,
        odd_profile,
        p_even,
        p_odd,
        is_even,
        is_odd,
    )


def by_amplitude(scene: Scene) -> AmplitudeView:
    """Compare trials of one waveform at two sizes: of a linear joint all scales."""
    different = [p for p in _alike(scene) if abs(p[2]) > _OTHER_SIZE]
    # Trials of one direction tell size from direction; others serve where there are none.
    pairs = [p for p in different if p[2] > 0] or different
    if not pairs:
        none = np.zeros(0)
        reason = (
            "No two trials are the same perturbation at two sizes, so whether the misfit scales "
            "with it is not known."
        )
        return AmplitudeView(False, reason, (), (), none, none, 1.0)
    combined = [_combined(scene, i, j, -ratio) for i, j, ratio in pairs]
    edges = time_edges(scene, {k for i, j, _ in pairs for k in (i, j)})
    profile, ratio, p_value = _profile(scene, combined, edges)
    significant = p_value <= scene.level
    size = f"{plain(np.sqrt(ratio))} times {scene.reference}"
    if significant:
        sentence = (
            "The residual does not scale with the perturbation (the difference is "
            f"{size}): what is missing is not linear."
        )
        if pairs[0][2] < 0:
            sentence = (
                "The residual does not scale with the perturbation (the difference is "
                f"{size}), but size and direction differ together."
            )
    elif misfit(scene, {k for i, j, _ in pairs for k in (i, j)}):
        sentence = (
            f"The misfit scales with the perturbation (the difference is {size}, "
            f"{probability(p_value)}): what is missing looks linear."
        )
    else:
        sentence = (
            f"Neither size shows a misfit (the scaled difference is {size}, "
            f"{probability(p_value)})."
        )
    return AmplitudeView(
        significant,
        sentence,
        _names(scene, pairs),
        tuple(float(p[2]) for p in pairs),
        edges,
        profile,
        p_value,
    )
