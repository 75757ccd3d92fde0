"""Places the discs of a team: those that hide one another fan out, and every number stays in sight.

Pages do the same in `viewer/static/crowd.js`, for the size and zoom that only the browser knows; a figure needs none.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from llm_flock_view._figures.labels import Rectangle, beside, box_at

ONE_PLACE = 0.9  # discs nearer than this many radii hide one another
APART = 1.6  # radii from which on one disc leaves the number of another in sight
ROOM = 7.0  # between the middle of a crowd and its discs, for the number in it [points]
MIN_ROOM = 6.0  # room without which the number of a crowd is left out [points]
PASSES = 4  # how often discs are moved aside: each move may bring one near another
TURNS = 12  # angles that are tried for a crowd among others


class Crowd(NamedTuple):
    """Robots that fan out around `middle`; their number stands at `spot`, None where there is no room [points]."""

    members: NDArray[np.intp]
    middle: NDArray[np.float64]
    spot: NDArray[np.float64] | None


def spread(discs: NDArray[np.float64], radius: float) -> tuple[NDArray[np.float64], list[Crowd]]:
    """The places of discs, shape (n, 2) [points], and the crowds that fan out; no disc stays on a number."""
    at = discs.copy()
    n = len(discs)
    rows, columns = np.nonzero(_gaps(discs, discs) < ONE_PLACE * radius)
    _, group = connected_components(coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)), directed=False)
    crowds = [members for k in range(int(group.max(initial=-1)) + 1) if len(members := np.flatnonzero(group == k)) > 1]
    middles = np.array([discs[members].mean(axis=0) for members in crowds]).reshape(-1, 2)
    for members, middle in zip(crowds, middles, strict=True):
        at[members] = _fan(middle, len(members), radius, np.delete(at, members, axis=0))
    for _ in range(PASSES):
        for i, j in np.argwhere(np.triu(_gaps(at, at) < APART * radius, 1)):
            aside = _aside(at[j] - at[i], APART * radius) / 2
            at[i], at[j] = at[i] - aside, at[j] + aside
        for i, k in np.argwhere(_gaps(at, middles) < radius + ROOM):
            at[i] += _aside(at[i] - middles[k], radius + ROOM)
    alone = _gaps(middles, middles) + np.diag(np.full(len(middles), np.inf)) > 2 * ROOM
    clear = _gaps(middles, at) > radius + MIN_ROOM
    free = [bool(a.all() and b.all()) for a, b in zip(alone, clear, strict=True)]
    return at, [Crowd(members, middles[k], middles[k] if free[k] else None) for k, members in enumerate(crowds)]


def spots(
    at: NDArray[np.float64], crowds: list[Crowd], radius: float, size: tuple[float, float], bounds: Rectangle
) -> list[Crowd]:
    """The same crowds; the number of one without room in its middle stands beside it [points]."""
    used = [box_at(spot, size) for spot in [one.spot for one in crowds] if spot is not None]
    found: list[Crowd] = []
    for one in crowds:
        wide = float(np.linalg.norm(at[one.members] - one.middle, axis=1).max()) + radius
        if one.spot is None:
            discs = np.concatenate([one.middle[None], np.delete(at, one.members, axis=0)])
            (offset,) = beside(discs, radius, [size], bounds, used, reach=wide)
            if offset is not None:
                spot = one.middle + np.array(offset)
                used.append(box_at(spot, size))
                found.append(one._replace(spot=spot))
                continue
        found.append(one)
    return found


def _gaps(some: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(some[:, None] - others[None], axis=2)


def _aside(way: NDArray[np.float64], apart: float) -> NDArray[np.float64]:
    """The shift along a way that restores a distance; zero where it is kept."""
    gap = float(np.linalg.norm(way)) or 1.0
    return max(0.0, apart - gap) / gap * way


def _fan(middle: NDArray[np.float64], count: int, radius: float, others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places on a circle around a middle, turned so that they stand as far as possible from all others."""
    wide = max(radius + ROOM, 1.2 * count * radius / math.pi)
    angles = 2.0 * np.pi * (np.arange(count) + np.arange(TURNS)[:, None] / TURNS) / count + np.pi / 2
    tried = middle + wide * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    if not len(others):
        return tried[0]
    return tried[int(np.linalg.norm(tried[:, :, None] - others, axis=3).min(axis=(1, 2)).round(1).argmax())]
