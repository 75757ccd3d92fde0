"""Colours beside each other are told apart with any colour vision; without any, letters, strokes and signs do it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from llm_flock.record._words import PALETTE
from llm_flock_view._figures.style import LINES, MARKERS, SERIES, SERIES_ON_DARK

# What is seen of linear RGB without one kind of cone (Machado, Oliveira, Fernandes 2009, severity 1).
SEEN = {
    "any": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)
LEAST = 12.0
"""Distance in CIELAB, where about 2.3 is just noticeable side by side."""


def distances(palette: Sequence[str], vision: str) -> NDArray[np.float64]:
    """Between all pairs of colours, as they are seen; shape (colours, colours)."""
    rgb = np.array([[int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)] for colour in palette])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.array(SEEN[vision]).T, 0, 1) @ TO_XYZ.T / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    lab = np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)
    return np.linalg.norm(lab[:, None] - lab[None], axis=2)


@pytest.mark.parametrize("vision", SEEN)
@pytest.mark.parametrize("palette", [PALETTE, SERIES, SERIES_ON_DARK], ids=["plans", "series", "series-on-dark"])
def test_adjacent_colours_can_be_distinguished(palette: Sequence[str], vision: str) -> None:
    table = distances(palette, vision)
    assert min(table[k, k + 1] for k in range(len(palette) - 1)) > LEAST


@pytest.mark.parametrize("vision", SEEN)
def test_any_two_of_ten_plans_can_be_told_apart(vision: str) -> None:
    table = distances(PALETTE, vision) + np.diag([np.inf] * len(PALETTE))
    assert len(PALETTE) == 10 and table.min() > 15.0, "each of ten robots may have a plan of its own"


def test_measure_sees_two_colours_as_one_without_a_cone() -> None:
    assert distances(["#D55E00", "#B07A00"], "deuteranopia")[0, 1] < 4, "so these two do not follow each other"


def test_no_two_series_of_one_colour_share_stroke_and_sign() -> None:
    looks = [(LINES[k % len(LINES)], MARKERS[k % len(MARKERS)]) for k in range(len(SERIES))]
    assert len(set(looks)) == len(SERIES), "curves are told apart without their colours"
