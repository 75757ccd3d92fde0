"""What a robot thought in a round: where its plan came from, whose claims it can hear, and how it was talked to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from llm_flock.record.schema import SILENT, LlmEntry
from llm_flock.viewer.reel import Reel


@dataclass(frozen=True, slots=True, kw_only=True)
class Descent:
    """One step of the way that a plan took to a robot.

    Attributes:
        round: when.
        robot: who had the plan from then on.
        source: whose it was before; None for the one who proposed it.
    """

    round: int
    robot: int
    source: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """What one robot holds, as another in radio range can hear it.

    Attributes:
        robot: whose claim.
        plan: letters of its plan.
        slot: its place in the plan, None without one.
        influence: share of the team that hears it.
        distance: how far away it is [units].
        rival: whether it wants the same place of the same plan.
    """

    robot: int
    plan: str
    slot: int | None
    influence: float
    distance: float
    rival: bool


def provenance(reel: Reel, robot: int, number: int) -> Sequence[Descent]:
    """How the plan that a robot follows in a round came to it, from the proposal on; empty without a plan."""
    plan_id = reel.states[number].plan_ids[robot]
    way: list[Descent] = []
    who: int | None = robot
    until = number
    while plan_id is not None and who is not None and len(way) <= reel.n_robots:
        turn = reel.turn(who, plan_id, until)
        if turn is None:
            break
        until, source = turn
        way.append(Descent(round=until, robot=who, source=source))
        who = source
    return way[::-1]


def claims(reel: Reel, robot: int, number: int) -> Sequence[Claim]:
    """What is claimed within a robot's radio range in a round, its own claim first, then the nearest ones."""
    state = reel.states[number]
    reach = float(reel.mission_at(number).mission["comm_range"])
    own = state.plan_ids[robot], state.slots[robot]
    found = [
        Claim(
            robot=other,
            plan=reel.plan_name(state.plan_ids[other]),
            slot=state.slots[other],
            influence=state.influence[other],
            distance=math.dist(state.positions[robot], state.positions[other]),
            rival=other != robot and own[1] is not None and own == (state.plan_ids[other], state.slots[other]),
        )
        for other in range(len(state.positions))
        if other == robot or state.phases[other] not in SILENT
    ]
    return sorted((c for c in found if c.distance <= reach), key=lambda c: (c.robot != robot, c.distance))


def price(entry: LlmEntry) -> str:
    """Tokens, time and money of a call."""
    cached = f" ({entry.usage.cached} cached)" if entry.usage.cached else ""
    cost = f" · ${entry.cost_usd:.4f}" if entry.cost_usd else ""
    faults = f" · {', '.join(entry.faults)}" if entry.faults else ""
    return f"{entry.usage.input} tokens in{cached}, {entry.usage.output} out · {entry.latency_s:.2f} s{cost}{faults}"
