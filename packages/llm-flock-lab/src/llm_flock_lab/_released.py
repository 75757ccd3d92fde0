"""The agreement and the collision check of the authors' program, for comparison: the preset `released`.

Written after its published behaviour (commit 30bba67 of Zhourobotics/LLM-Flock). It is not decentralised: rules share
state over the whole team, so a team flies it in one process only. Two passes of the program are left out, as they
change nothing here: influence between pairs after the leaders, as all in reach of each other follow one plan by then;
and names of followers that only colour its figures.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from llm_flock.algorithm1 import nearest_available
from llm_flock.arrays import Point, flattened
from llm_flock.message import Message
from llm_flock.planner import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol import AssignmentInput, Claim, InfluenceConsensus, NearestFreeAssignment, Standing
from llm_flock.runtime import Trial

BUFFER = 0.5  # added to the safe distance [units]
REPROMPTS = 2  # how often robots in conflict are asked again in a round


@dataclass(frozen=True, slots=True)
class LeaderConsensus(InfluenceConsensus):
    """All robots in reach of each other adopt the plan of their leader, relayed.

    The leader has the highest influence; of several the one that was followed most often, then the one of lowest id.
    """

    name: str = "leader"
    _followed: Counter[int] = field(default_factory=Counter[int])

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """The message of the leader; None for the leader, and for those who follow its plan already."""

        def rank(degree: int, robot: int) -> tuple[int, int, int]:
            return degree, self._followed[robot], -robot

        with_plan = [message for message in heard if message.plan is not None]
        leader = max(with_plan, key=lambda m: rank(m.degree, m.sender), default=None)
        if leader is None or (
            own.plan is not None and rank(own.degree, own.robot) > rank(leader.degree, leader.sender)
        ):
            return None
        if own.plan == leader.plan and _proposer(own) == _proposer(leader):
            return None
        self._followed[leader.sender] += 1
        return leader


def _proposer(of: Standing | Message) -> int | None:
    return None if of.provenance is None else of.provenance.proposer


@dataclass(frozen=True, slots=True)
class SharedTable(NearestFreeAssignment):
    """One table of the goals taken, for the whole team. Robots that adopt a plan choose one after the other, by id."""

    name: str = "shared-table"
    _taken: dict[int, tuple[object, int]] = field(default_factory=dict[int, tuple[object, int]])

    def take(self, now: AssignmentInput) -> Claim:
        """The model's index on its own plan; else the nearest goal that nobody has, or its own id if all are taken."""
        plan = (now.plan.digest, None if now.origin is None else now.origin.proposer)
        taken = {slot for robot, (other, slot) in self._taken.items() if other == plan and robot != now.robot}
        if not now.adopted:
            slot = now.robot if now.chosen is None else now.chosen
        elif len(taken) < len(now.plan):
            slot = nearest_available(now.position, now.plan.points, taken)
        else:
            slot = min(now.robot, len(now.plan) - 1)
        self._taken[now.robot] = plan, slot
        return Claim(slot=slot)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """Unchanged, unless the same points come from another proposer now: that is another plan to the program."""
        known, proposer = self._taken.get(now.robot), None if now.origin is None else now.origin.proposer
        return claim if known is not None and known[0] == (now.plan.digest, proposer) else self.take(now)


async def central_check(
    trial: Trial, asked: Mapping[int, StepQuestion], steps: Mapping[int, StepAnswer | NoAnswer]
) -> dict[int, StepAnswer | NoAnswer]:
    """Ask again those who would come too near and are nearer to their goals, twice; then hold all that still would."""
    mission = trial.config.mission
    margin, downwash = mission.safe_distance + BUFFER, mission.downwash
    answers, start = dict(steps), trial.bodies.positions
    for _ in range(REPROMPTS):
        pairs = _conflicts(start, answers, margin, downwash)
        if not pairs:
            break
        again = {_yielding(pair, asked): pair for pair in pairs}
        answers |= await trial.ask_steps(
            {
                robot: replace(asked[robot], objection=_objection(robot, pairs, start, answers, margin))
                for robot in sorted(again)
                if robot in asked
            }
        )
    held = set[int]()
    while new := {robot for pair in _conflicts(start, answers, margin, downwash) for robot in pair} - held:
        held |= new
        for robot in new & answers.keys():
            answers[robot] = NoAnswer(cause="held", reason="held by the collision check")
    return answers


def _ends(start: np.ndarray, answers: Mapping[int, StepAnswer | NoAnswer]) -> np.ndarray:
    ends = start.copy()
    for robot, answer in answers.items():
        if isinstance(answer, StepAnswer):
            ends[robot] = answer.waypoint
    return ends


def _conflicts(
    start: np.ndarray, answers: Mapping[int, StepAnswer | NoAnswer], margin: float, downwash: float
) -> list[tuple[int, int]]:
    """Pairs of robots that would come nearer than the margin on the way, or at the end."""
    one, two = np.triu_indices(len(start), 1)
    start, ends = (flattened(rows, downwash) for rows in (start, _ends(start, answers)))
    move = ends - start
    offset, change = start[one] - start[two], move[one] - move[two]
    # The program looks from just after the start, so that a pair that starts too near may part.
    squared = np.maximum((change**2).sum(axis=1), 1e-12)
    share = np.clip(-(offset * change).sum(axis=1) / squared, 1e-6, 1.0)
    near = np.linalg.norm(offset + share[:, None] * change, axis=1) < margin
    return [*zip(one[near].tolist(), two[near].tolist(), strict=True)]


def _yielding(pair: tuple[int, int], asked: Mapping[int, StepQuestion]) -> int:
    """The robot of a pair that has to give way: the one nearer to its goal; of two as near, the one of higher id."""

    def urgency(robot: int) -> tuple[float, int]:
        question = asked.get(robot)
        return (0.0 if question is None else math.dist(question.position, question.goal)), -robot

    return min(pair, key=urgency)


def _objection(
    robot: int,
    pairs: Sequence[tuple[int, int]],
    start: np.ndarray,
    answers: Mapping[int, StepAnswer | NoAnswer],
    margin: float,
) -> str:
    ends = _ends(start, answers)

    def way(of: int) -> str:
        return f"{_shown(start[of])} to {_shown(ends[of])}"

    others = [one if two == robot else two for one, two in pairs if robot in (one, two)]
    named = "; ".join(f"robot {other}, which flies from {way(other)}" for other in others)
    return f"Your way from {way(robot)} comes nearer than {margin:g} to: {named}. Choose another position."


def _shown(row: np.ndarray) -> list[float]:
    point: Point = tuple(row.tolist())
    return [round(x, 3) for x in point]
