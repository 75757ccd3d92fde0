"""Two robots that meet head-on in a corridor exchange places, by what they tell each other and nothing else."""

from __future__ import annotations

import math

import pytest
from driven_team import DrivenTeam

from llm_flock.arrays import Point
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan

CORRIDOR = (
    Obstacle(polygon=((30, -5), (70, -5), (70, 48), (30, 48))),
    Obstacle(polygon=((30, 52), (70, 52), (70, 105), (30, 105))),
)
ENDS: tuple[Point, Point] = (20.0, 50.0), (80.0, 50.0)
MISSION = Mission(shape="points", points=ENDS, n_robots=2, center=(50, 50), comm_range=15, obstacles=CORRIDOR)
PLAN = Plan.of(ENDS)
HEARD, UNHEARD = ((1,), (0,)), ((), ())


class Corridor(DrivenTeam):
    """Two robots, each with the place beyond the other, that fly towards each other."""

    def __init__(self, apart: float = 44.0) -> None:
        super().__init__(MISSION, "flock", [PLAN, PLAN])
        self.begin([(25.0, 50.0), (75.0, 50.0)], HEARD)
        for _ in range(5):
            self.comm_round()
        assert self.slots == [0, 1]
        self.end()
        # Something has carried both to the other end.
        self.positions: list[Point] = [(50.0 + apart / 2, 50.0), (50.0 - apart / 2, 50.0)]

    def fly(self, rounds: int, *, heard: bool) -> None:
        """Rounds in which each flies straight on, and hears the other within radio range, or not at all."""
        for _ in range(rounds):
            near = heard and math.dist(*self.positions) <= MISSION.comm_range
            self.begin(self.positions, HEARD if near else UNHEARD)
            for _ in range(5):
                self.comm_round()
            moves = self.end({i: self._step(i) for i in range(2)})
            self.positions = [moves[i].waypoint for i in range(2)]

    def _step(self, robot: int) -> Point:
        (x, _), slot = self.positions[robot], self.slots[robot]
        assert slot is not None
        return (x + max(-6.0, min(6.0, PLAN.points[slot][0] - x)), 50.0)

    @property
    def squares(self) -> float:
        """The sum of squared distances to the places: what an exchange lowers."""
        pairs = zip(self.positions, self.slots, strict=True)
        return sum(math.dist(x, PLAN.points[slot or 0]) ** 2 for x, slot in pairs)


def test_robots_exchange_on_hearing_each_other_and_turn_round() -> None:
    team = Corridor()
    while math.dist(*team.positions) > MISSION.comm_range:
        assert team.slots == [0, 1], "out of radio range neither knows of the other"
        team.fly(1, heard=True)
    before = team.squares
    team.fly(1, heard=True)
    assert team.slots == [1, 0] and team.squares < before / 2
    team.fly(6, heard=True)
    there = [math.dist(x, PLAN.points[1 - i]) for i, x in enumerate(team.positions)]
    assert max(there) <= AT_GOAL * MISSION.spacing


def test_robots_without_messages_exchange_no_places() -> None:
    """To see another body head-on is not enough: without a message neither knows what the other's place is."""
    team = Corridor(apart=14.0)
    team.fly(4, heard=False)
    assert team.slots == [0, 1] and math.dist(*team.positions) < 5.0


@pytest.mark.parametrize("apart", [-4.0, -14.0])
def test_robots_keep_places_if_an_exchange_would_cost(apart: float) -> None:
    """The same meeting, but each with its place behind it."""
    team = Corridor(apart)
    before = team.squares
    team.fly(3, heard=True)
    assert team.slots == [0, 1] and team.squares < before
