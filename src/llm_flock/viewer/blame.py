"""Who or what kept a team from its formation, by its record: models, deaths, links, obstacles, rules.

Needs no numerical library: the first page waits for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

from llm_flock.record.schema import DEAD
from llm_flock.record.words import MOST_PLACES, counted, robots_text, sentence
from llm_flock.viewer.last_round import AT_GOAL, IN_SHAPE, MOST_GROUPS, LastRound, begun, crosses

if TYPE_CHECKING:
    from llm_flock.viewer.recording import Recording

HOPELESS = 0.5
"""Share of unusable answers from which on a robot's model is blamed."""

JUDGED, ASTRAY, LEAST_ASTRAY = 20, 0.4, 5
"""Last steps that are judged, and the share and number of those away from the goal from which on a model is blamed."""

STRIDE = 0.5
"""Share of the step limit by which a robot that is on its way comes nearer to its goal in a round."""

LOSSY = 0.3
"""Share of lost messages from which on the links are blamed."""

MOST_POINTS = 250
"""Largest plan that is measured: the work grows with the square of it."""

LONGEST = 160
"""Most letters of a refusal that is quoted."""

SETTLING = ("provenance", "auction")
"""The rules by which a team in radio contact comes to one plan, and to a place for each robot."""


class Blame(NamedTuple):
    """Why a team did not form, in sentences, and the robots that they name as its cause.

    `look` is a robot that is worth a look, and why, where no robot is the cause.
    """

    why: str
    robots: tuple[int, ...] = ()
    look: tuple[int, str] | None = None


def blame(run: Recording) -> Blame:
    """Who or what kept the team from its last mission, by the record up to its last round."""
    if not run.rounds:
        return Blame("")
    end = LastRound(run)
    found: list[Blame] = []
    for find in _CAUSES:
        cause = find(run, end, frozenset(robot for one in found for robot in one.robots))
        if cause is not None:
            found.append(cause)
    fact, involved, look = end.fact()
    settles = _settles(run)
    if not found:
        if fact and not settles:
            return Blame(f"No robot is to blame: {_rules_blame(run, end)} {fact}", (), look)
        return Blame(fact or "By the record, nothing was wrong in the last round.", involved, look)
    robots = tuple(dict.fromkeys(robot for cause in found for robot in cause.robots))
    told = [cause.why for cause in found[:MOST_GROUPS]]
    if not settles and end.quarrel(robots):
        others = "The other robots did not agree either" if robots else "The robots did not agree"
        told.append(f"{others}, {_rules_alone(run)}.")
    elif len(told) < MOST_GROUPS and not (involved and {*involved} <= {*robots}):
        told.append(fact)
    return Blame(" ".join(filter(None, told)), robots, look)


def dead_robots(run: Recording) -> list[int]:
    """The robots that are dead in the last round."""
    return [robot for robot, phase in enumerate(run.states[run.rounds].phases) if phase == DEAD]


def deaths_text(run: Recording) -> str:
    """Who died, and when; empty if all are alive."""
    dead = dead_robots(run)
    rounds = sorted({run.died[robot] for robot in dead if robot in run.died})
    when = f" in round{'s' if len(rounds) > 1 else ''} {', '.join(map(str, rounds[:MOST_PLACES]))}" if rounds else ""
    return f"{robots_text(dead)} died{when}" if dead else ""


def hopeless(run: Recording, robot: int) -> bool:
    """Whether at least half of the answers of a robot's model were of no use."""
    tally = run.tallies.get(robot)
    return tally is not None and tally.unusable > 0 and tally.unusable >= HOPELESS * tally.asked


def _settles(run: Recording) -> bool:
    """Whether rules bring a team in radio contact together; True for those of which the record says nothing."""
    return run.rules == SETTLING or not all(run.rules)


def _were(robots: Sequence[int]) -> str:
    return "was" if len(robots) == 1 else "were"


def _accused(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    if not run.accused:
        return None
    told = [
        f"Robot {robot} was accused of sending what no honest robot sends: {run.accused[robot]}"
        for robot in sorted(run.accused)
    ]
    return Blame(". ".join(told[:MOST_GROUPS]) + ".", tuple(sorted(run.accused)))


def _answers(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Models that gave hardly a usable answer."""
    poor = [robot for robot in end.awake if hopeless(run, robot)]
    hit = {*end.without, *end.strays, *end.shared, *end.away}
    # Where one of them went wrong, models whose robots had help are not to blame.
    robots = [robot for robot in poor if robot in hit] or poor
    if not robots:
        return None
    tallies = [run.tallies[robot] for robot in robots]
    unusable, asked = sum(tally.unusable for tally in tallies), sum(tally.asked for tally in tallies)
    last = next((tally.last for tally in reversed(tallies) if tally.last), "").strip()
    quoted = f" The last reason: {sentence(last, LONGEST)}" if last else ""
    calls = f"{unusable} of {counted(asked, 'call')}"
    said = f"{begun(robots_text(robots))}: {_models(run, robots)} gave no usable answer in {calls}.{quoted}"
    return Blame(said, tuple(robots))


def _plans(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Plans in use that are not the shape, by whoever proposed them."""
    ideal = run.mission_at(run.rounds).ideal
    if not ideal or len(ideal) > MOST_POINTS:
        return None
    wanted = _apart(ideal)
    told: list[str] = []
    robots: dict[int, None] = {}
    for plan_id in dict.fromkeys(plan for robot in end.awake if (plan := end.state.plan_ids[robot]) is not None):
        plan = run.plans.get(plan_id)
        if plan is None or len(plan.points) != len(ideal) or len(told) == MOST_GROUPS:
            continue
        off = sum(abs(a - b) for a, b in zip(_apart(plan.points), wanted, strict=True)) / max(1, len(wanted))
        if off <= IN_SHAPE * end.spacing:
            continue
        robots[plan.proposer] = None
        held = [robot for robot in end.awake if end.state.plan_ids[robot] == plan_id]
        who = "all flew it" if len(held) == len(end.awake) else f"{robots_text(held)} flew it"
        whose = "geometry" if run.made_by_geometry(plan_id) else _models(run, [plan.proposer])
        told.append(
            f"Robot {plan.proposer}: {whose} proposed a plan that is off the shape (distances between its places by "
            f"{off:.2g} units on average), and {who}."
        )
    return Blame(" ".join(told), tuple(robots)) if told else None


def _apart(points: Sequence[Sequence[float]]) -> list[float]:
    """Distances of all pairs in order of size: the same for a shape wherever it stands and however it is turned."""
    return sorted(math.dist(one, other) for one, other in combinations(points, 2))


def _steps(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Models whose steps led away from their goals."""
    told: list[str] = []
    robots: list[int] = []
    first = max(1, run.mission_at(run.rounds).round, run.rounds - JUDGED + 1)
    for robot in end.away:
        judged = [away for k in range(first, run.rounds + 1) if (away := _led_away(run, robot, k)) is not None]
        astray = sum(judged)
        if astray < LEAST_ASTRAY or astray < ASTRAY * len(judged):
            continue
        robots.append(robot)
        told.append(
            f"Robot {robot}: {_models(run, [robot])} led it away from its goal in {astray} of its last {len(judged)} "
            "steps."
        )
    return Blame(" ".join(told[:MOST_GROUPS]), tuple(robots)) if told else None


def _led_away(run: Recording, robot: int, number: int) -> bool | None:
    """Whether a model's step ended farther from the goal than it began; None where no model chose the step."""
    state, before = run.states[number], run.states[number - 1]
    to, at = state.waypoints[robot], before.positions[robot]
    # A goal may change after the question: a step towards the one or the other is no mistake.
    goals = [goal for goal in (state.goals[robot], before.goals[robot]) if goal is not None]
    if to is None or not goals or state.origins[robot] not in ("model", "clipped"):
        return None
    near = AT_GOAL * float(run.mission_at(number).mission["spacing"])
    return all(math.dist(to, goal) > max(near, math.dist(at, goal) - 1e-3) for goal in goals)


def _dead(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    dead = dead_robots(run)
    if not dead:
        return None
    others = "and the others did not fill the formation" if end.awake else "and nobody was left"
    return Blame(f"{begun(deaths_text(run))}, {others}.", tuple(dead))


def _ended(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Runs that ended before they could form."""
    result = run.result or {}
    if result.get("stopped") == "budget":
        return Blame(f"The budget was used up in round {run.rounds}.")
    if result.get("stopped") == "interrupted":
        return Blame(f"The run was ended in round {run.rounds}.")
    if result.get("stopped") != "rounds" or end.alone:
        return None
    step = float(end.mission["max_step"])
    coming = [
        robot
        for robot in end.away
        if robot not in named and end.far(robot) > step and all(_nearer(run, robot, k) > STRIDE * step for k in (0, 1))
    ]
    if not coming:
        return None
    last = max(coming, key=end.far)
    were = (
        f"was still on its way, {end.far(last):.0f} units from its place"
        if len(coming) == 1
        else f"were still on their way, up to {end.far(last):.0f} units from their places"
    )
    return Blame(f"{begun(robots_text(coming))} {were}, when the rounds were used up.")


def _nearer(run: Recording, robot: int, ago: int) -> float:
    """By how much a robot came nearer to its last goal in the last round, or the one before [units]."""
    goal, states = run.states[run.rounds].goals[robot], run.states
    if goal is None or run.rounds <= ago:
        return 0.0
    after, before = states[run.rounds - ago].positions[robot], states[run.rounds - ago - 1].positions[robot]
    return math.dist(before, goal) - math.dist(after, goal)


def _links(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Robots that could not hear the others, and messages that were lost."""
    told: list[str] = []
    robots: list[int] = []
    parts = end.parts()
    apart = sorted(robot for part in parts[1:] for robot in part)
    last = next((k for k in range(run.rounds, -1, -1) if run.rows[k].connected), None)
    if not _settles(run):
        # With rules that bring no team together, robots that have met part because of these.
        robots = [robot for robot in apart if not end.alone and robot not in named and not end.met(robot)]
        if robots:
            out = f"{_were(robots)} out of radio range of all others in every round"
            told.append(f"{begun(robots_text(robots))} {out}.")
    elif not {*apart} <= named:  # who was named before is apart for that reason
        once = "never were all robots in contact" if last is None else f"all were in contact up to round {last}"
        if len(parts) == len(end.awake):
            told.append("At the end no robot was in radio range of another one.")
        elif 2 * len(parts[0]) > len(end.awake):
            robots = apart
            told.append(
                f"{begun(robots_text(robots))} {_were(robots)} out of radio range of the others at the end; {once}."
            )
        else:
            some = "; ".join(robots_text(part) for part in parts[:MOST_GROUPS])
            more = "; and so on" if len(parts) > MOST_GROUPS else ""
            told.append(f"The team was in {len(parts)} parts out of radio range of one another: {some}{more}.")
    if run.loss >= LOSSY:
        told.append(f"{100 * run.loss:.0f} % of the messages were lost.")
    return Blame(" ".join(told), tuple(robots)) if told else None


def _blocked(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """Robots that agreed with all others, and were kept from their places by what was in the way."""
    if end.without or len(end.groups) > 1 or end.shared:
        return None
    told: list[str] = []
    robots: list[int] = []
    for robot in end.away:
        goal = end.state.goals[robot]
        way = (end.state.positions[robot], goal or end.state.positions[robot])
        recent = [event for k in range(max(1, run.rounds - 9), run.rounds + 1) for event in run.events(k)]
        waits = [event for event in recent if event.robot == robot and event.kind in ("deadlock", "gives_way")]
        if any(crosses(way, obstacle) for obstacle in end.mission.get("obstacles", ())):
            why = "an obstacle stood in its way"
        elif waits:
            why = "other robots were in its way"
        else:
            continue
        robots.append(robot)
        told.append(f"Robot {robot} had not reached its place: {why}.")
    return Blame(" ".join(told[:MOST_GROUPS]), tuple(robots)) if told else None


def _shape(run: Recording, end: LastRound, named: frozenset[int]) -> Blame | None:
    """All are at their places, and these are not those of the shape."""
    steps = run.provenance(end.awake[0], run.rounds) if end.awake else []
    error = run.rows[run.rounds].procrustes_mean
    if end.fact()[0] or not steps or error is None or error <= IN_SHAPE * end.spacing:
        return None
    robot = steps[0].robot
    return Blame(f"Robot {robot} proposed a plan that is {error:.2g} units off the shape, and all flew it.", (robot,))


_CAUSES = (_accused, _answers, _plans, _steps, _dead, _ended, _links, _blocked, _shape)
"""Causes in the order in which they are told."""


def _rules_blame(run: Recording, end: LastRound) -> str:
    if run.rules[0] == "none":
        own = "each robot kept its own plan" if len(end.groups) == len(end.awake) else "robots kept plans of their own"
        return f"this protocol has no consensus, so {own}."
    rules = f"this protocol's rules ({', '.join(run.rules)})"
    return f"{rules} did not bring the team to one plan and each robot to a place of its own."


def _rules_alone(run: Recording) -> str:
    return (
        "for this protocol has no consensus"
        if run.rules[0] == "none"
        else f"by this protocol's rules ({', '.join(run.rules)})"
    )


def _models(run: Recording, robots: Sequence[int]) -> str:
    """The models of some robots, by their names where the record has them."""
    names = dict.fromkeys(run.tallies[robot].model for robot in robots if robot in run.tallies)
    some = ", ".join([name for name in names if name][:MOST_GROUPS])
    return f"{'its model' if len(robots) == 1 else 'their models'}{f' ({some})' if some else ''}"
