"""An arena in which a formation has room."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from llm_flock import formations
from llm_flock.arrays import Point, Vector
from llm_flock.mission import Mission, start_volume


def fitted_arena(
    team: Mission, shape: str, n_robots: int, points: Sequence[Point] | None = None
) -> tuple[Point, Point]:
    """The team's arena, grown where a formation needs it.

    Every wall is moved out, if need be, until it is at least as far from the centre as the farthest place of the shape
    (in any orientation) and one spacing more, so that a robot can pass between formation and wall. If random starts
    that keep the safe distance would not fit then, all walls are moved out to a cube in which they do. An arena that
    fits already is returned as it is; no wall is ever moved inwards.

    Args:
        team: gives centre, spacing, safe distance and the arena to begin with [units], and the number of places if it
            is not one for each robot.
        shape: a shape, in the words of a mission.
        n_robots: team size N.
        points: target points of the shape `points` [units].

    Returns:
        lower and upper corner [units].

    Raises:
        InputError: there is no such shape, or not for this team size.
    """
    center = np.array(team.center)
    ideal = formations.ideal_points(shape, team.places or n_robots, team.center, team.spacing, points)
    room = 0.0 if ideal is None else formations.circumradius(ideal, team.center) + team.spacing
    low, high = _grown(team, center, room)
    needed = start_volume(n_robots, team.dim, team.safe_distance)
    if float(np.prod(high - low)) < needed:
        # A thousandth more, so that rounding cannot make it too small again.
        low, high = _grown(team, center, 1.001 * math.pow(needed, 1 / team.dim) / 2)
    return tuple(low.tolist()), tuple(high.tolist())


def _grown(team: Mission, center: Vector, room: float) -> tuple[Vector, Vector]:
    """Corners of the arena after moving each wall out to `room` from the centre."""
    low, high = (np.array(corner) for corner in team.arena)
    return np.minimum(low, center - room), np.maximum(high, center + room)
