"""The way home: all drones fly in step to above their own starts, under the shield, before they are landed there.

No model is asked, and no plan is agreed on: each drone has a fixed goal. It flies towards it, gives way and asks for a
way as in a mission, by its sensors and by the courses that robots in radio range sent in the last step.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Sequence

import numpy as np

from llm_flock.arrays import Point, Points, towards
from llm_flock.mission import Mission
from llm_flock.protocol import Observation, ShieldedSafety, leg_to
from llm_flock.simulate import Readings
from llm_flock_flight._flight.config import FlightConfig

STEPS, STEPS_EACH = 20, 4
"""Most steps on the way home: some, and some for each step of the longest way and for each drone."""


def homes_of(config: FlightConfig, starts: Points) -> Points:
    """The places of return, shape (n, d) [units]: above each start of the flight file, or else above where it stood."""
    homes = starts.copy()
    for robot, drone in enumerate(config.fleet.drones):
        if drone.start is not None:
            x, y = drone.start[:2]
            homes[robot] = config.frame.to_mission((x, y, config.world.altitude_m))
    return homes


class WayHome:
    """Joint steps of a team from any places to `homes`, shape (n, d) [units]; home is within `near` of it [units].

    Where homes are nearer to each other than the safe distance, some drones do not get there.
    """

    def __init__(self, mission: Mission, homes: Points, near: float) -> None:
        self._mission, self._near = mission, near
        self._homes: list[Point] = [tuple(row) for row in homes.tolist()]
        self._safety = [ShieldedSafety(robot, mission, 0.0) for robot in range(len(homes))]

    def far(self, places: Points) -> list[int]:
        """Drones that are not at home yet."""
        rows: list[list[float]] = places.tolist()
        return [
            k for k, (row, home) in enumerate(zip(rows, self._homes, strict=True)) if math.dist(row, home) > self._near
        ]

    def most_steps(self, places: Points) -> int:
        """Number of steps after which drones that are not at home land where they are."""
        longest = float(np.linalg.norm(places - np.array(self._homes), axis=1).max())
        return STEPS + STEPS_EACH * (math.ceil(longest / self._mission.max_step) + len(self._homes))

    def step(self, team: Readings) -> Points:
        """How each drone moves next, shape (n, d) [units]."""
        last_courses = {robot: mind.course for robot, mind in enumerate(self._safety)}
        after: list[Point] = []
        for robot, (mind, home) in enumerate(zip(self._safety, self._homes, strict=True)):
            seen = team.sense(robot)
            here = seen.position
            courses = {j: course for j in team.in_radio_range[robot] if (course := last_courses[j]) is not None}
            leg = leg_to(self._mission, here, home)
            wish = towards(here, leg.stop, self._mission.max_step)
            scene = Observation(position=here, sensed=seen.sensed, courses=courses)
            after.append(mind.step(scene, wish, leg, self._near).waypoint)
        return np.array(after) - team.places


async def fly_home(
    config: FlightConfig, team: Readings, move: Callable[[Points], Awaitable[None]], homes: Points
) -> Sequence[int]:
    """Fly all drones home by `move`, which may raise; returns those that did not get there, to be landed."""
    way = WayHome(config.mission, homes, config.safety.tracking_m / config.world.scale_m)
    for _ in range(way.most_steps(team.places)):
        if not way.far(team.places):
            break
        await move(way.step(team))
    return way.far(team.places)
