"""The team in the last round of a run: plans, claims, ways to the places, and parts out of radio range."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from llm_flock.record.schema import SILENT
from llm_flock.record.words import robots_text

if TYPE_CHECKING:
    from llm_flock.viewer.recording import Recording

AT_GOAL, IN_SHAPE = 0.05, 0.1
"""As shares of the spacing, as in `llm_flock.metrics.agreement`, whose libraries load too slowly for a first page."""

MOST_LOOKED_AT = 20_000
"""Most distances of one robot that are looked at."""

MOST_GROUPS = 3
"""Most groups of robots, plans, and causes that are told."""


class LastRound:
    """The team in the last round."""

    def __init__(self, run: Recording) -> None:
        self.run, self.state = run, run.states[run.rounds]
        state, self.mission = self.state, run.mission_at(run.rounds).mission
        self.spacing = float(self.mission["spacing"])
        self.awake = [robot for robot, phase in enumerate(state.phases) if phase not in SILENT]
        self.without = [robot for robot in self.awake if state.plan_ids[robot] is None]
        owners = Counter((state.plan_ids[robot], state.slots[robot]) for robot in self.awake)
        self.shared = [
            robot
            for robot in self.awake
            if state.slots[robot] is not None and owners[state.plan_ids[robot], state.slots[robot]] > 1
        ]
        self.away = [robot for robot in self.awake if self.far(robot) > AT_GOAL * self.spacing]
        held: defaultdict[str, list[int]] = defaultdict(list)
        for robot in self.awake:
            if state.plan_ids[robot] is not None:
                held[run.plan_name(state.plan_ids[robot])].append(robot)
        self.groups = sorted(held.items(), key=lambda one: (-len(one[1]), one[0]))
        largest = self.groups[0][1] if self.groups else []
        # Where no plan has most of the robots, none of them stands apart from the team.
        self.most = 2 * len(largest) > len(self.awake) - len(self.without)
        others = self.groups[1 if self.most else 0 :] if len(self.groups) > 1 else []
        self.alone = run.rules[0] == "none"
        self.strays = sorted(robot for _, members in others for robot in members)

    def far(self, robot: int) -> float:
        """Distance of a robot from its goal; 0 without one [units]."""
        goal = self.state.goals[robot]
        return 0.0 if goal is None else math.dist(self.state.positions[robot], goal)

    def quarrel(self, robots: Sequence[int]) -> bool:
        """Whether the team without some robots, and without their plans, has several plans or claims a place twice."""
        others = [robot for robot in self.awake if robot not in robots]
        owned = {plan for plan, info in self.run.plans.items() if info.proposer in robots}
        claims = [(self.state.plan_ids[robot], self.state.slots[robot]) for robot in others]
        claims = [claim for claim in claims if claim[0] is not None and claim[0] not in owned]
        return len({plan for plan, _ in claims}) > 1 or len(set(claims)) < len(claims)

    def fact(self) -> tuple[str, tuple[int, ...], tuple[int, str] | None]:
        """What was wrong in the last round, whom it is about, and who is worth a look; empty where nothing was."""
        if self.without:
            return (
                f"{begun(robots_text(self.without))} got no plan.",
                tuple(self.without),
                (self.without[0], "it has no plan"),
            )
        if len(self.groups) > 1 and self.alone:
            plans = f"{len(self.groups)} plans were in use at the end."
            return plans, (), (self.groups[-1][1][0], "it kept a plan of its own")
        if len(self.groups) > 1:
            told = [f"{robots_text(held)} had plan {name}" for name, held in self.groups[:MOST_GROUPS]]
            held = f"{robots_text(self.strays)} held another than most" if self.most else "; ".join(told)
            more = "" if self.most or len(self.groups) <= MOST_GROUPS else "; and so on"
            fewest = self.groups[-1][1][0]
            return (
                f"The team did not agree: {len(self.groups)} plans were in use at the end; {held}{more}.",
                tuple(self.strays) if self.most else (),
                (fewest, "it holds another plan than most" if self.most else "few others hold its plan"),
            )
        if self.shared:
            one = len({(self.state.plan_ids[robot], self.state.slots[robot]) for robot in self.shared}) == 1
            claimed = "claimed the same place" if one else "claimed places that others claimed too"
            return (
                f"{begun(robots_text(self.shared))} {claimed}.",
                tuple(self.shared),
                (self.shared[0], "another robot claims its place too"),
            )
        if self.away:
            places = "its place" if len(self.away) == 1 else "their places"
            return (
                f"{begun(robots_text(self.away))} had not reached {places}.",
                tuple(self.away),
                (max(self.away, key=self.far), "it has not reached its place"),
            )
        return "", (), None

    def parts(self) -> list[list[int]]:
        """The robots that hear one another, directly or through others; the largest part first."""
        reach, positions = float(self.mission["comm_range"]), self.state.positions
        left, parts = set(self.awake), list[list[int]]()
        while left:
            part, new = set[int](), {min(left)}
            while new:
                part |= new
                left -= new
                new = {other for other in left if any(math.dist(positions[k], positions[other]) <= reach for k in new)}
            parts.append(sorted(part))
        return sorted(parts, key=lambda part: (-len(part), part))

    def met(self, robot: int) -> bool:
        """Whether a robot was in radio range of any other in any round; not looked at in a very large run."""
        reach, states = float(self.mission["comm_range"]), self.run.states[: self.run.rounds + 1]
        others = [other for other in range(self.run.n_robots) if other != robot]
        return len(states) * len(others) > MOST_LOOKED_AT or any(
            math.dist(state.positions[robot], state.positions[other]) <= reach for state in states for other in others
        )


def crosses(way: tuple[Sequence[float], Sequence[float]], obstacle: Mapping[str, Any]) -> bool:
    """Whether a straight way meets an obstacle: a disc, a ball, or, seen from above, a polygon."""
    start, goal = way
    if obstacle.get("polygon") is not None:
        corners = cast("Sequence[Sequence[float]]", obstacle["polygon"])
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        return any(_cross(start, goal, one, other) for one, other in sides)
    middle = cast("Sequence[float]", obstacle["center"])
    along = [b - a for a, b in zip(start, goal, strict=True)]
    long = sum(part * part for part in along) or 1.0
    share = sum((m - a) * part for m, a, part in zip(middle, start, along, strict=False)) / long
    nearest = [a + min(1.0, max(0.0, share)) * part for a, part in zip(start, along, strict=True)]
    return math.dist(nearest[: len(middle)], middle[: len(nearest)]) < float(obstacle["radius"])


def _cross(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float]) -> bool:
    """Whether two lines, each from a point to another, cross."""

    def side(p: Sequence[float], q: Sequence[float], r: Sequence[float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def begun(text: str) -> str:
    """A text with a capital letter first."""
    return text[:1].upper() + text[1:]
