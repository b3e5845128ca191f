"""What all figures and pages have in common: colours that can be told apart, letters on paper."""

import io
import re
from itertools import combinations

import matplotlib.image as mpimg
import numpy as np
import pytest
from matplotlib.figure import Figure

from identifiability.plots.style import CYCLE, MODEL_COLOURS, PAGE, png_of, printed, save
from identifiability.report.page import Page

# Machado, Oliveira & Fernandes (2009): how each kind of complete colour blindness sees linear RGB.
VISION = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
SRGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
APART = 10  # distance in CIELAB, of which 2.3 can just be seen


def linear(colour):
    """Linear RGB of ``#rrggbb`` or ``#rgb``."""
    digits = colour.lstrip("#")
    digits = "".join(2 * d for d in digits) if len(digits) == 3 else digits
    value = np.array([int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(colour, vision):
    """CIELAB of a colour as it is seen."""
    seen = np.clip(np.array(VISION[vision]) @ linear(colour), 0, 1)
    ratio = SRGB_TO_XYZ @ seen / SRGB_TO_XYZ.sum(axis=1)
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def nearest(colours, vision):
    """Distance of the two colours that are hardest to tell apart."""
    return min(
        float(np.linalg.norm(lab(a, vision) - lab(b, vision))) for a, b in combinations(colours, 2)
    )


@pytest.mark.parametrize("vision", VISION)
def test_lines_are_told_apart_with_any_colour_vision(vision):
    assert nearest(CYCLE, vision) > APART
    assert nearest(MODEL_COLOURS, vision) > APART


def test_red_and_green_alike_are_seen():
    alike = ("#d62728", "#2ca02c")  # of a common palette
    assert nearest(alike, "normal") > APART
    assert nearest(alike, "deuteranopia") < APART


def contrast(first, second):
    """Ratio of luminances as the Web Content Accessibility Guidelines (2.2) define it."""
    low, high = sorted(float(SRGB_TO_XYZ[1] @ linear(c)) for c in (first, second))
    return (high + 0.05) / (low + 0.05)


def test_words_of_a_page_can_be_read_by_day_and_by_night():
    shades = [
        dict(re.findall(r"--(\w+): (#[0-9a-f]+)", rule))
        for rule in re.findall(r":root \{(.*?)\}", Page("title").render(), re.DOTALL)
    ]
    day, night = (shade for shade in shades if shade)
    for shade in (day, night):
        assert {"paper", "ink", "quiet", "stress", "bad"} <= set(shade)
        for ink in ("ink", "quiet", "bad"):
            for paper in ("paper", "stress"):
                assert contrast(shade[ink], shade[paper]) > 4.5, (ink, paper)
    assert contrast("#999999", "#ffffff") < 4.5


@printed
def long_names():
    """A figure that is as wide as its names are long."""
    figure = Figure(figsize=(PAGE, 2.0))
    axes = figure.subplots()
    axes.barh(range(3), range(3))
    axes.set_yticks(range(3), ["torque of past motion, one way (+)"] * 3)
    axes.set_xlabel("powers of ten by which it is more probable than noise")
    return figure


@pytest.mark.parametrize("dpi", [None, 100, 130, 300])
def test_no_letter_is_cut_at_any_resolution(tmp_path, dpi):
    # Sizes are laid out once, for no resolution in particular.
    if dpi is None:
        drawn = mpimg.imread(io.BytesIO(png_of(long_names())))
    else:
        drawn = mpimg.imread(save(long_names(), tmp_path / "drawn.png", dpi=dpi))
    ink = drawn[..., :3].min(axis=2) < 1
    edges = {"left": ink[:, :2], "right": ink[:, -2:], "top": ink[:2], "bottom": ink[-2:]}
    assert not [side for side, band in edges.items() if band.any()]
    assert ink[:, : drawn.shape[1] // 5].any()
