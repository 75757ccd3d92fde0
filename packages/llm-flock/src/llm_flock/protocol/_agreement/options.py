"""What a team can do about an incident, with the figures that code expects of each option."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import scipy

from llm_flock.arrays import Point, Points
from llm_flock.message import BLOCKED, NO_OWNER, BidTable, Incident
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle, clearance
from llm_flock.plan import Plan
from llm_flock.planner import Choice, JudgementOption, PlanAnswer, PlanQuestion
from llm_flock.protocol._geometry import geometric_plan
from llm_flock.protocol._membership.occupancy import reachable, waiting_place
from llm_flock.protocol._membership.search import LOOKS_FOR_SILENT, NEXT_TO
from llm_flock.protocol._membership.search import PATIENCE as SEARCH_PATIENCE
from llm_flock.protocol._membership.team import REPLAN_PATIENCE
from llm_flock.protocol._parts import Situation
from llm_flock.protocol._verification.validator import resized
from llm_flock.shapes import rotated

MARGIN = 1.05
"""The way for which a battery should last, as a multiple of the way that code expects: others may be in the way."""

LARGEST = 60  # largest team in which robots close up: the shape errors of all moves are compared
TURNS = 8  # orientations of a new plan over which the flight to it is averaged: the model that proposes it may turn it


def death_options(now: Situation, first: Choice = "leave") -> tuple[JudgementOption, ...]:
    """What can be done about places that dead robots left empty; `first` is what happens without a choice."""
    mission, plan, table = now.mission, now.plan, now.claim.table
    assert plan is not None and table is not None, "an incident is about the places of a plan"
    owned = tuple(a for a, entry in enumerate(table) if entry[2] >= 0)
    unseen = tuple(a for a, (_, visits, owner) in enumerate(table) if owner == NO_OWNER and visits < LOOKS_FOR_SILENT)
    gaps = len(plan) - len(owned) if _holes(mission, plan, owned) else 0
    rounds, flown = _search(mission, plan, owned, unseen)
    options = [JudgementOption(choice="leave", does="Leave the place empty.", rounds=rounds, distance=flown, gaps=gaps)]
    move = closing(mission, plan, table) if gaps else None
    if move is not None:
        left, gap = move
        far, after = math.dist(plan.points[left], plan.points[gap]), tuple(sorted({*owned, gap} - {left}))
        rounds, flown = _search(mission, plan, after, (left,))
        rounds += math.ceil(far / mission.max_step - 1e-9)
        does = f"Close up: robot {table[left][2]} leaves its place at the edge and fills the gap."
        options.append(JudgementOption(choice="close", does=does, rounds=rounds, distance=far + flown, gaps=0))
    smaller = resized(mission, len(owned)) if owned else None
    if smaller is not None and smaller.ideal is not None:
        does = f"Make a new plan of {len(owned)} places for the robots that are left."
        ways = _ways_to_new_plan(smaller, plan, owned)
        rounds = REPLAN_PATIENCE + 2 + round(float(np.mean([math.ceil(way.max() / mission.max_step) for way in ways])))
        flown = float(np.mean([way.sum() for way in ways]))
        options.append(JudgementOption(choice="replan", does=does, rounds=rounds, distance=flown, gaps=0))
    return tuple(sorted(options, key=lambda option: option.choice != first))


def _search(mission: Mission, plan: Plan, owned: Sequence[int], vacant: Sequence[int]) -> tuple[int, float]:
    """Rounds and flying of the robots beside vacant places that look there once for the missing robot."""
    ways = [(math.dist(plan.points[a], plan.points[gap]), gap) for gap in vacant for a in owned]
    nearest = min(ways, default=(0.0, 0))[0]
    looks = [way for way, _ in ways if way <= max(nearest * (1 + AT_GOAL), NEXT_TO * mission.spacing)]
    longest = max(looks, default=0.0)
    return (SEARCH_PATIENCE + 2 + 2 * math.ceil(longest / mission.max_step - 1e-9) if looks else 0), 2.0 * sum(looks)


def closing(mission: Mission, plan: Plan, table: BidTable) -> tuple[int, int] | None:
    """The slot that its robot leaves, and the gap that it fills, for the whole shape of fewer robots; else None.

    Of several such moves it is the shortest one.
    """
    vacant = tuple(a for a, entry in enumerate(table) if entry[2] == NO_OWNER)
    owned = tuple(a for a, entry in enumerate(table) if entry[2] >= 0)
    if not vacant or len(owned) > LARGEST or any(entry[2] == BLOCKED for entry in table):
        return None
    return _closing(mission, plan, owned, vacant)


@lru_cache(maxsize=256)
def _closing(mission: Mission, plan: Plan, owned: tuple[int, ...], vacant: tuple[int, ...]) -> tuple[int, int] | None:
    moves = sorted((round(math.dist(plan.points[a], plan.points[gap]), 6), a, gap) for a in owned for gap in vacant)
    for _, a, gap in moves:
        if not _holes(mission, plan, tuple(sorted({*owned, gap} - {a}))):
            return a, gap
    return None


@lru_cache(maxsize=1024)
def _holes(mission: Mission, plan: Plan, owned: tuple[int, ...]) -> bool:
    """Whether robots on these places do not form the whole shape of as many robots, by their distances."""
    smaller = resized(mission, len(owned)) if owned else None
    if smaller is None or smaller.ideal is None:
        return True
    shapes = (np.array(smaller.ideal), plan.array[list(owned)])
    ideal, here = (np.sort(scipy.spatial.distance.pdist(points)) for points in shapes)
    return float(np.abs(ideal - here).mean()) > AT_GOAL * mission.spacing


@lru_cache(maxsize=64)
def _ways_to_new_plan(smaller: Mission, plan: Plan, owned: tuple[int, ...]) -> tuple[Points, ...]:
    """Ways of the robots on these places to those of a new plan, for some orientations of it [units]."""
    here, ideal, found = plan.array[list(owned)], np.array(smaller.ideal), list[Points]()
    for k in range(TURNS):
        there = rotated(ideal, smaller.center, 2.0 * math.pi * k / TURNS)
        ways = scipy.spatial.distance.cdist(here, there)
        found.append(ways[scipy.optimize.linear_sum_assignment(ways**2)])
    return tuple(found)


def battery_options(
    incident: Incident, now: Situation, robot: int, present: frozenset[int]
) -> tuple[JudgementOption, ...]:
    """What can be done about a weak battery, as `robot` sees it; the first goes on. Empty without a place for it."""
    mission, plan, weak = now.mission, now.plan, incident.robot
    table = now.claim.table or ()
    slots = {owner: a for a, (_, _, owner) in enumerate(table) if owner >= 0}
    if plan is None or weak not in slots:
        return ()
    places, own = plan.points, slots[weak]
    where = {**now.sensed, robot: now.position}

    def way(here: Point, there: Point) -> float:
        return math.dist(here, there) if now.ways is None else now.ways.length(here, there)

    def option(choice: Choice, does: str, flown: float, other: float = 0.0, saved: float = 0.0) -> JudgementOption:
        lost = int(flown * MARGIN > incident.left)
        rounds = math.ceil(max(flown, other) / mission.max_step - 1e-9)
        distance = max(flown + other - saved, 0.0)
        return JudgementOption(choice=choice, does=does, rounds=rounds, distance=distance, gaps=lost, lost=lost)

    straight = way(incident.at, places[own])
    options = [option("continue", f"Robot {weak} goes on to its place.", straight)]
    near = {j: where.get(j, places[a]) for j, a in slots.items() if j != weak}
    near = {j: x for j, x in near.items() if math.dist(x, incident.at) <= mission.comm_range}
    near = {} if mission.prefer else near  # places that are given by preference are not exchanged
    peer = min(near, key=lambda j: (round(way(incident.at, places[slots[j]]), 6), j), default=None)
    if peer is not None and (short := way(incident.at, places[slots[peer]])) < straight - AT_GOAL * mission.spacing:
        does = f"Robot {weak} exchanges its place with robot {peer}."
        other, saved = way(near[peer], places[own]), way(near[peer], places[slots[peer]])
        options.append(option("swap", does, short, other, saved))
    spares = {j: where.get(j, mission.center) for j in present - slots.keys() - {weak}}
    if spares and straight > AT_GOAL * mission.spacing:
        spare = min(spares, key=lambda j: (round(way(spares[j], places[own]), 6), j))
        does = f"Robot {weak} gets out of the way, and spare robot {spare} takes its place."
        others = [x for j, x in where.items() if j != weak]
        aside = math.dist(incident.at, waiting_place(mission, incident.at, plan, others))
        options.append(option("spare", does, aside, way(spares[spare], places[own])))
    return tuple(options)


def resting_at(incident: Incident) -> Obstacle:
    """The obstacle in a robot's way."""
    return Obstacle(center=incident.at, radius=incident.left)


def way_past(obstacles: tuple[Obstacle, ...], here: Point, place: Point, now: Situation) -> float:
    """Length of the way to a place, also round these `obstacles` [units]; infinite if there is none."""
    mission = now.terrain.among(obstacles)
    if clearance(place, obstacles) < reachable(mission):
        return math.inf
    return math.dist(here, place) if mission.roadmap is None else mission.roadmap.length(here, place)


def blocked_options(
    incident: Incident, now: Situation, robot: int, present: frozenset[int]
) -> tuple[JudgementOption, ...]:
    """What can be done about a blocked way, as `robot` sees it; the first waits. Empty if it does not see the other."""
    mission, plan, table, stuck = now.mission, now.plan, now.claim.table or (), incident.robot
    slots = {owner: a for a, (_, _, owner) in enumerate(table) if owner >= 0}
    where = {**now.sensed, robot: now.position}
    if plan is None or stuck not in slots or stuck not in where:
        return ()
    disc, place = (resting_at(incident),), plan.points[slots[stuck]]

    def option(choice: Choice, does: str, ways: Sequence[float], gaps: int = 0, wait: int = 0) -> JudgementOption:
        rounds = wait + math.ceil(max(ways) / mission.max_step - 1e-9)
        return JudgementOption(choice=choice, does=does, rounds=rounds, distance=sum(ways), gaps=gaps)

    options = [option("wait", f"Robot {stuck} waits where it is, and its place stays empty.", [0.0], gaps=1)]
    if math.isfinite(way := way_past(disc, where[stuck], place, now)):
        options.append(option("round", f"Robot {stuck} goes round the obstacle to its place.", [way]))
    spares = {j: way_past(disc, where[j], place, now) for j in present & where.keys() - slots.keys()}
    spare = min(spares, key=lambda j: (round(spares[j], 6), j), default=stuck)
    if math.isfinite(way := spares.get(spare, math.inf)):
        options.append(option("spare", f"Robot {stuck} gives its place to spare robot {spare}.", [way]))
    if clearance(place, disc) < reachable(mission):
        asked = PlanQuestion(mission=mission.among(disc), robot=robot, round=1, position=now.position, neighbors=())
        found = geometric_plan(asked)
        if isinstance(found, PlanAnswer):
            here = [where.get(j, plan.points[a]) for j, a in slots.items()]
            ways = scipy.spatial.distance.cdist(here, found.plan.array)
            flown = ways[scipy.optimize.linear_sum_assignment(ways**2)]
            does = "Make a new plan of as many places, clear of the obstacle."
            options.append(option("replan", does, flown.tolist(), wait=REPLAN_PATIENCE + 2))
    return tuple(options)


def order_options(
    incident: Incident, now: Situation, robot: int, present: frozenset[int]
) -> tuple[JudgementOption, ...]:
    """What can be done about an order in words, as `robot` sees it; the first goes on."""
    mission, plan, table, named = now.mission, now.plan, now.claim.table, incident.robot
    assert plan is not None and table is not None, "an order is judged by robots with a plan"
    places, slots = plan.points, {owner: a for a, (_, _, owner) in enumerate(table) if owner >= 0}
    where = {**now.sensed, robot: now.position}
    ways = {j: way_past((), where.get(j, places[a]), places[a], now) for j, a in slots.items()}
    near, moves = AT_GOAL * mission.spacing, mission.velocity is not None

    def option(choice: Choice, does: str, ways: Iterable[float], aside: float = 0.0) -> JudgementOption:
        flown = [way for way in ways if math.isfinite(way)]
        rounds = math.ceil(max([*flown, aside]) / mission.max_step - 1e-9)
        gaps = len(plan) - len(flown)
        return JudgementOption(choice=choice, does=does, rounds=rounds, distance=sum(flown) + aside, gaps=gaps)

    options = [option("continue", "Go on as planned.", ways.values())]
    there = [0.0 for way in ways.values() if way <= near and not moves]
    if len(there) < len(ways):
        options.append(option("wait", "All robots wait where they are, until another order.", there))
    if len(slots) < len(plan):
        options += [one for one in death_options(now) if one.choice != "leave"]
    spares = present - slots.keys() if named in slots else ()
    far = {j: way_past((), where.get(j, mission.center), places[slots[named]], now) for j in spares}
    if far:
        spare = min(far, key=lambda j: (round(far[j], 6), j))
        does = f"Robot {named} gets out of the way, and spare robot {spare} takes its place."
        here, others = where.get(named, places[slots[named]]), [x for j, x in where.items() if j != named]
        aside = math.dist(here, waiting_place(mission, here, plan, others))
        options.append(option("spare", does, [*(ways | {named: far[spare]}).values()], aside))
    return tuple(options)
