"""The paper's Algorithm 1: influence, adoption of plans, and the nearest available place, with a runnable example.

`python -m llm_flock.algorithm1` flies three robots that start with a plan each. The functions are those that the rules
`influence`, `nearest` and `nearest-free` of a run use (`protocol._agreement`). Line numbers are those of the paper's
source; everything a robot needs here it has measured itself or heard from a neighbour.

The paper can be read in two ways where it says that an assigned goal "becomes unavailable for others" (line 135):

- `nearest-free`, by the text: a goal that a neighbour on the same plan claims is taken. Messages then carry claims,
  which the broadcast of line 133 does not have, and of two robots with the same goal the one with the higher id yields.
  The preset `paper` does this.
- `nearest`, by the pseudocode (lines 154-156): the available goals are reset to the whole plan by each robot that
  adopts one, and no other robot learns what it takes. Two robots may take the same goal. The preset `paper-literal`
  does this.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from llm_flock.arrays import Point

READINGS = ("nearest-free", "nearest")


class Heard(Protocol):
    """A broadcast of a robot (line 133): its plan, and its degree, which gives its influence."""

    @property
    def sender(self) -> int:
        """Id of the robot."""
        ...

    @property
    def degree(self) -> int:
        """Number of its neighbours, |N_i|."""
        ...

    @property
    def plan(self) -> object:
        """The plan that it follows; None before it has one."""
        ...


H = TypeVar("H", bound=Heard)


def neighbors(positions: Sequence[Point], robot: int, comm_range: float) -> list[int]:
    """N_i: the other robots within radio range (line 131)."""
    here = positions[robot]
    return [j for j, there in enumerate(positions) if j != robot and math.dist(here, there) <= comm_range]


def influence(degree: int, n_robots: int) -> float:
    """I_i = |N_i| / N (equation 1, line 129); its largest value is (N - 1) / N."""
    return degree / n_robots


def adopt(
    own_degree: int, own_plan: object, heard: Iterable[H], *, lowest: bool = True, yields_to: int = 0
) -> H | None:
    """The broadcast whose plan to adopt, or None to keep one's own plan (lines 133 and 151-153).

    All influences are shares of one N, so degrees are compared. The paper does not say which of several equally
    influential neighbours is k: here the one of the `lowest` id, or else of the highest. By its text a robot keeps its
    plan if k is only as influential as itself; one that `yields_to` ids below its own then adopts the plan of such a k.
    """
    sign = -1 if lowest else 1
    k = max(heard, key=lambda j: (j.degree, sign * j.sender), default=None)  # k <- argmax over N_i of I_j
    if k is None or k.plan is None or k.plan == own_plan:
        return None
    if k.degree > own_degree or (k.degree == own_degree and k.sender < yields_to):  # if I_k > I_i and P_k != P_i
        return k  # P_i <- P_k
    return None


def nearest_available(position: Point, plan: Sequence[Point], taken: Collection[int] = ()) -> int:
    """Index of the place to take in a plan (lines 137 and 154-156): the nearest, and of equally near ones the first.

    `taken` are the places that are not available: none in the reading `nearest`, those that neighbours with the same
    plan claim in `nearest-free`. The nearest of all where every place is taken.
    """
    available = [a for a in range(len(plan)) if a not in taken] or range(len(plan))  # P_avail <- P_i without taken
    return min(available, key=lambda a: (math.dist(position, plan[a]), a))  # g_i <- argmin over P_avail of |x_i - p|


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoRobot:
    """One robot of the demonstration: its broadcast, and its position [units]."""

    sender: int
    position: Point
    plan: tuple[Point, ...]
    slot: int
    degree: int = 0

    @property
    def goal(self) -> Point:
        """g_i, the place that it flies to."""
        return self.plan[self.slot]


def consensus_round(team: Sequence[DemoRobot], comm_range: float, reading: str) -> list[DemoRobot]:
    """One round of Algorithm 1, for all robots i in parallel, from the broadcasts at its beginning."""
    positions = [robot.position for robot in team]
    around = [neighbors(positions, i, comm_range) for i in range(len(team))]
    broadcasts = [replace(robot, degree=len(near)) for robot, near in zip(team, around, strict=True)]
    after: list[DemoRobot] = []
    for i, robot in enumerate(broadcasts):
        heard = [broadcasts[j] for j in around[i]]
        k = adopt(robot.degree, robot.plan, heard)
        plan = robot.plan if k is None else k.plan
        claims = {j.sender: j.slot for j in heard if j.plan == plan} if reading == "nearest-free" else {}
        yields = any(slot == robot.slot and j < i for j, slot in claims.items())
        if k is not None or yields:
            robot = replace(robot, plan=plan, slot=nearest_available(robot.position, plan, claims.values()))
        after.append(robot)
    return after


def flown(robot: DemoRobot, max_step: float) -> DemoRobot:
    """The robot one step nearer to its goal; in the paper its language model chooses this step."""
    away = math.dist(robot.position, robot.goal)
    share = min(1.0, max_step / away) if away else 0.0
    there = tuple(x + share * (g - x) for x, g in zip(robot.position, robot.goal, strict=True))
    return replace(robot, position=there)


def three_robots() -> list[DemoRobot]:
    """Robots in a row, each with a triangle of its own around (50, 50); only the middle one hears both others."""
    starts = ((36.0, 38.0), (48.0, 38.0), (60.0, 38.0))
    radius, team = 10.0 / math.sqrt(3.0), list[DemoRobot]()
    for i, start in enumerate(starts):
        angles = [math.tau * k / 3 + 0.4 * i for k in range(3)]
        plan = tuple((50.0 + radius * math.cos(a), 50.0 + radius * math.sin(a)) for a in angles)
        team.append(DemoRobot(sender=i, position=start, plan=plan, slot=i))
    return team


def main(arguments: Sequence[str] = ()) -> None:
    """Fly three robots by one of the two readings, the text's if none is given, and print the decisions of each."""
    reading = arguments[0] if arguments else READINGS[0]
    if reading not in READINGS:
        raise SystemExit(f"reading = {reading!r}: must be {' or '.join(READINGS)}")
    team, comm_range, max_step = three_robots(), 15.0, 6.0  # line 184: the paper's radio range and step limit
    owners = {robot.plan: robot.sender for robot in team}
    for number in range(1, 6):
        before, team = team, consensus_round(team, comm_range, reading)
        print(f"round {number}")
        for was, robot in zip(before, team, strict=True):
            news = " (adopted)" if robot.plan != was.plan else ""
            share = influence(robot.degree, len(team))
            print(f"  robot {robot.sender}: I = {share:.2f}, plan of {owners[robot.plan]}{news}, place {robot.slot}")
        team = [flown(robot, max_step) for robot in team]
    plans, places = len({robot.plan for robot in team}), len({robot.goal for robot in team})
    print(f"{plans} plan{'s' * (plans > 1)}, {places} of {len(team)} goals taken ({reading})")


if __name__ == "__main__":
    main(sys.argv[1:])
