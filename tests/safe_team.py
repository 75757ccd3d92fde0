"""A team that wants nothing but its goals: each robot flies round obstacles as its own safety lets it."""

import math
from collections import Counter
from typing import Any

import numpy as np
from rounds import observation

from llm_flock.message import Course
from llm_flock.metrics import AT_GOAL, segment_separation
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle, segment_clearance
from llm_flock.protocol._motion.leg import leg_to
from llm_flock.protocol._motion.safety import ShieldedSafety

SAFE = 3.0


class SafeTeam:
    """Robots that fly straight to their goals, as far as their safety lets them."""

    def __init__(self, starts: object, goals: object, *obstacles: Obstacle, downwash: float = 1.0) -> None:
        self.positions = np.array(starts, dtype=float)
        self.goals = np.array(goals, dtype=float)
        n, dim = self.positions.shape
        arena = ((0.0,) * dim, (100.0,) * dim)
        fields: dict[str, Any] = {"obstacles": obstacles, "arena": arena, "center": (50.0,) * dim}
        fields |= {"downwash": downwash, "sense_range": 12.0 + 3.0 * downwash}
        self.mission = Mission(shape="text:any", n_robots=n, **fields)
        self.robots = [ShieldedSafety(i, self.mission, 0.0) for i in range(n)]
        self.kinds: Counter[str] = Counter()
        self.origins: Counter[str] = Counter()
        self.courses: dict[int, Course] = {}
        self.smallest = math.inf
        self.clearance = math.inf

    def fly(self, rounds: int) -> int | None:
        """The round after which all are at their goals, None if that does not come."""
        for number in range(rounds):
            if float(np.linalg.norm(self.positions - self.goals, axis=1).max()) < 0.5:
                return number
            self.round()
        return None

    def heard(self, receiver: int, sender: int) -> bool:
        """Whether a course arrives; every one does here."""
        return True

    def round(self) -> None:
        before = self.positions
        rows = [tuple(row) for row in before.tolist()]
        after = before.copy()
        for i, safety in enumerate(self.robots):
            sensed = {j: x for j, x in enumerate(rows) if j != i and math.dist(x, rows[i]) <= self.mission.sensing}
            goal = tuple(self.goals[i].tolist())
            leg = leg_to(self.mission, rows[i], goal)
            far = math.dist(rows[i], leg.stop)
            share = min(1.0, self.mission.max_step / max(far, 1e-9))
            wish = leg.stop
            if share < 1.0:
                wish = tuple(x + share * (g - x) for x, g in zip(rows[i], leg.stop, strict=True))
            courses = {j: course for j, course in self.courses.items() if j in sensed and self.heard(i, j)}
            flight = safety.step(
                observation(rows[i], sensed, courses=courses), wish, leg, AT_GOAL * self.mission.spacing
            )
            self.origins[flight.origin.value] += 1
            self.kinds.update(note.kind for note in flight.notes)
            self.clearance = min(self.clearance, segment_clearance(rows[i], flight.waypoint, self.mission.obstacles))
            after[i] = flight.waypoint
        self.courses = {i: safety.course for i, safety in enumerate(self.robots) if safety.course is not None}
        self.smallest = min(self.smallest, segment_separation(before, after, downwash=self.mission.downwash))
        self.positions = after
