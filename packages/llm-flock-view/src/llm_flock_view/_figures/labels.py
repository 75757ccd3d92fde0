"""Places words beside discs: on no disc and no other word and, if there is room, on no ring and no line.

Pages do the same in `viewer/static/labels.js`, for the size and zoom that only the browser knows; a figure needs none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

Rectangle = tuple[float, float, float, float]  # left, right, bottom, top

DIRECTIONS = tuple(math.radians(angle) for angle in (90, 270, 45, 135, 315, 225, 0, 180))
"""Tried in this order: above is where readers look first."""

STEPS = 6  # distances from the disc that are tried in each direction; each is half a disc farther out
HINTED = 1.1  # small words on a screen are wider than their outlines by up to this factor
LINE = 0.6  # half the width of a ring [points]
GAP = 1.0  # gap between a word and its neighbours [points]


class Outlines(NamedTuple):
    """Lines to keep free of words [points]: rings (middle and radius), shape (m, 3), and lines, shape (k, 2, 2)."""

    rings: NDArray[np.float64]
    lines: NDArray[np.float64]

    def cross(self, box: Rectangle) -> bool:
        """Whether a ring or a line passes through a box."""
        low, high = np.array([box[0], box[2]]), np.array([box[1], box[3]])
        if len(self.rings):
            middles, radii = self.rings[:, :2], self.rings[:, 2]
            nearest = np.linalg.norm(np.clip(middles, low, high) - middles, axis=1)
            farthest = np.linalg.norm(np.maximum(abs(middles - low), abs(middles - high)), axis=1)
            if bool(((nearest < radii + LINE) & (farthest > radii - LINE)).any()):
                return True
        if not len(self.lines):
            return False
        start, along = self.lines[:, 0], self.lines[:, 1] - self.lines[:, 0]
        along = np.where(along == 0.0, 1e-12, along)
        one, other = (low - start) / along, (high - start) / along
        first = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
        return bool((first <= np.minimum(np.maximum(one, other).min(axis=1), 1.0)).any())


NOTHING = Outlines(np.empty((0, 3)), np.empty((0, 2, 2)))


def beside(
    discs: NDArray[np.float64],
    radius: float,
    words: Sequence[tuple[float, float]],
    bounds: Rectangle,
    taken: Sequence[Rectangle] = (),
    before: Sequence[tuple[float, float] | None] | None = None,
    outlines: Outlines = NOTHING,
    reach: float | None = None,
) -> list[tuple[float, float] | None]:
    """From the middle of each disc to that of its word [points]; None where there is no room.

    `words` are sizes of the words of the first discs, `taken` other places to keep free, `before` is where the words
    stood a moment ago, so that they do not jump about; `reach` is where words begin, by default at the radius.
    """
    found: list[tuple[float, float] | None] = [None] * len(words)
    used = [*taken]
    apart = np.linalg.norm(discs[:, None] - discs[None], axis=2)
    # Whoever has the nearest neighbours has the least choice, and chooses first.
    crowd = np.exp(-apart / (4.0 * radius)).sum(axis=1)
    for k in sorted(range(len(words)), key=lambda k: -crowd[k]):
        taken_by_word: Rectangle = (0.0, 0.0, 0.0, 0.0)
        earlier = [] if before is None else [before[k]]
        for offset in (*filter(None, earlier), *_offsets(radius if reach is None else reach, words[k])):
            box = box_at((float(discs[k, 0]) + offset[0], float(discs[k, 1]) + offset[1]), words[k])
            if not _free(box, discs, radius, bounds, used):
                continue
            clear = not outlines.cross(box)
            if clear or found[k] is None:
                found[k], taken_by_word = offset, box
            if clear:
                break
        if found[k] is not None:
            used.append(taken_by_word)
    return found


def _offsets(radius: float, word: tuple[float, float]) -> Iterator[tuple[float, float]]:
    for step in range(STEPS):
        out = radius + GAP + 0.5 * step * radius
        for angle in DIRECTIONS:
            yield math.cos(angle) * (out + word[0] / 2), math.sin(angle) * (out + word[1] / 2)


def _free(
    box: Rectangle, discs: NDArray[np.float64], radius: float, bounds: Rectangle, used: Sequence[Rectangle]
) -> bool:
    left, right, bottom, top = bounds
    if box[0] < left or box[1] > right or box[2] < bottom or box[3] > top:
        return False
    if any(_overlap(box, other) for other in used):
        return False
    nearest = np.column_stack([np.clip(discs[:, 0], box[0], box[1]), np.clip(discs[:, 1], box[2], box[3])])
    return bool(np.linalg.norm(nearest - discs, axis=1).min() >= radius)


def box_at(middle: Sequence[float] | NDArray[np.float64], word: tuple[float, float]) -> Rectangle:
    x, y, (width, height) = float(middle[0]), float(middle[1]), word
    return (x - width / 2, x + width / 2, y - height / 2, y + height / 2)


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] < b[1] + GAP and b[0] < a[1] + GAP and a[2] < b[3] + GAP and b[2] < a[3] + GAP


@lru_cache(maxsize=4096)
def size_of(text: str, size: float) -> tuple[float, float]:
    """Width and height of a word in the house's font [points]."""
    if not text.strip():
        return 0.0, 0.0
    outline: Any = TextPath((0, 0), text, size=size, prop=FontProperties(family="DejaVu Sans"))
    return HINTED * float(outline.get_extents().x1), size
