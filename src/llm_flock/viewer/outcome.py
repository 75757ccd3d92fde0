"""What came of a run: which missions were formed and when, and who kept the team from the others.

The first screen answers these three questions with it, before anybody has clicked on anything.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from llm_flock.record.schema import DEAD, SILENT
from llm_flock.record.words import MOST_PLACES, counted, robots_text, work_text

if TYPE_CHECKING:
    from llm_flock.viewer.recording import Recording

AT_GOAL, IN_SHAPE = 0.05, 0.1
"""As shares of the spacing, as in `llm_flock.metrics.agreement`, whose libraries load too slowly for a first page."""

HELD_ROUNDS = 3
HOPELESS = 0.5
"""Share of unusable answers from which on a robot's model is blamed."""

MOST_GROUPS = 3
"""Groups of robots that are listed."""

LONGEST = 160
"""Most letters of a refusal that is quoted."""

_STOPPED = {
    "rounds": "the rounds were used up",
    "budget": "the budget was used up",
    "no_plan": "no model proposed an acceptable plan",
    "no_answers": "no model answered",
    "interrupted": "the run was ended early",
    "failed": "the run failed",
}


class MissionPart(NamedTuple):
    """One mission of a run: its first round, its last one (None while it is in force), and when it was formed."""

    first: int
    last: int | None
    text: str
    formed: int | None


class Blame(NamedTuple):
    """Why a team did not form, in a sentence, and the robots that it names."""

    why: str
    robots: tuple[int, ...] = ()


def mission_parts(run: Recording) -> list[MissionPart]:
    """The missions in their order; `formed` is a round of the run, as its result says, or while it flies, its rows."""
    given = list(run.missions)
    said = (run.result or {}).get("missions")
    told = cast(
        "Sequence[object]", said if isinstance(said, list) and len(cast("list[object]", said)) == len(given) else ()
    )
    parts: list[MissionPart] = []
    for k, info in enumerate(given):
        last = given[k + 1].round - 1 if k + 1 < len(given) else None
        parts.append(MissionPart(info.round, last, shape_text(info.mission), _formed(run, k, told, last)))
    return parts


def shape_text(mission: Mapping[str, Any]) -> str:
    """The shape and its number of places, and the number of robots where it is another one."""
    n, places = mission["n_robots"], mission.get("places")
    return f"{mission['shape']} of {n}" if places in (None, n) else f"{mission['shape']} of {places}, {n} robots"


def _formed(run: Recording, k: int, told: Sequence[object], last: int | None) -> int | None:
    if told and isinstance(told[k], dict):
        formed = cast("dict[str, Any]", told[k]).get("formed")
        return formed if isinstance(formed, int) else None
    since = max(0, run.missions[k].round - 1)
    if run.result is not None and last is None:
        # An older record: the result is about the last mission only, and counts from when it was given.
        took = run.result.get("rounds_to_formed")
        return since + took if run.result.get("formed") and isinstance(took, int) else None
    return _formed_by_rows(run, run.missions[k].round, run.rounds if last is None else min(last, run.rounds))


def _formed_by_rows(run: Recording, first: int, last: int) -> int | None:
    """The first of three rounds in order after the team last changed, as measured: for a run that still flies."""
    held = 0
    since = run.disturbed if run.disturbed <= last else 0
    for number in range(max(1, first, since), last + 1):
        row, info = run.rows[number], run.mission_at(number)
        awake = sum(phase not in SILENT for phase in run.states[number].phases)
        close = row.procrustes_mean is None or row.procrustes_mean <= IN_SHAPE * float(info.mission["spacing"])
        order = row.plans_in_use == 1 and row.robots_at_goal >= awake == row.distinct_goals and close
        held = held + 1 if order else 0
        if held == HELD_ROUNDS:
            return number - HELD_ROUNDS + 1
    return None


def outcome(run: Recording) -> dict[str, Any]:
    """What the banner of a page says: see `mission_parts` and `blame`; `tone` is good, bad or open."""
    parts = mission_parts(run)
    over = not run.open
    last = parts[-1]
    found = blame(run) if over and last.formed is None else Blame("")
    tone = "good" if last.formed is not None else "bad" if over else "open"
    return {
        "tone": tone,
        "headline": _headline(run, parts, over=over),
        "protocol": protocol_name(run),
        "why": found.why,
        "by": _begun(_work(run)) if last.formed is not None else "",
        "guilty": list(found.robots),
        "interesting": interesting(run, found),
        "missions": [
            {"first": part.first, "last": part.last, "text": part.text, "formed": part.formed} for part in parts
        ],
    }


def _headline(run: Recording, parts: Sequence[MissionPart], *, over: bool) -> str:
    last = parts[-1]
    name = f"Mission {len(parts)} of {len(parts)} ({last.text}) " if len(parts) > 1 else ""
    if last.formed is not None:
        after = f", after {counted(last.formed - max(0, last.first - 1), 'round')}" if len(parts) > 1 else ""
        return _begun(f"{name}formed in round {last.formed}{after}{_helped(run)}{_gaps(run)}")
    if not over:
        return _begun(f"{name}not formed yet")
    return _begun(f"{name}not formed: {stop_text(run)}")


def _helped(run: Recording) -> str:
    """Whether the models did it alone; older records do not say."""
    if (run.result or {}).get("formed_by_models", True):
        return ""
    return ", by geometry without models" if run.without_models else ", with help for the models"


def _gaps(run: Recording) -> str:
    gaps = (run.result or {}).get("gaps")
    return f", with {counted(gaps, 'place')} empty" if isinstance(gaps, int) and gaps > 0 else ""


def _work(run: Recording) -> str:
    """Who died, and who did the work."""
    work = work_text(run.result or {}).replace(",", ", ").replace(",  ", ", ")  # so that a list of faults breaks
    return " · ".join(part for part in (_deaths_text(run), work) if part)


def _deaths_text(run: Recording) -> str:
    """Who died, and when; empty if all are alive."""
    dead = _dead(run)
    rounds = sorted({run.died[robot] for robot in dead if robot in run.died})
    when = f" in round{'s' if len(rounds) > 1 else ''} {', '.join(map(str, rounds[:MOST_PLACES]))}" if rounds else ""
    return f"{robots_text(dead)} died{when}" if dead else ""


def _dead(run: Recording) -> list[int]:
    return [robot for robot, phase in enumerate(run.states[run.rounds].phases) if phase == DEAD]


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def stop_text(run: Recording) -> str:
    """Why the run ended, in words."""
    if run.result is None:
        return "the record ends early"
    stopped = str(run.result.get("stopped", "ended"))
    if stopped == "rounds" and run.rounds < 2:
        return "the only round was used up" if run.rounds else "no round was flown"
    if stopped == "rounds":
        return f"all {run.rounds} rounds were used up"
    return _STOPPED.get(stopped, stopped)


def protocol_name(run: Recording) -> str:
    """The name of the protocol, or its rules where it has none."""
    config: dict[str, Any] = {} if run.info is None else run.info.config.get("protocol", {})
    rules = " + ".join(str(config[name]) for name in ("consensus", "assignment") if config.get(name))
    return str(config.get("protocol") or rules)


def blame(run: Recording) -> Blame:
    """Who or what kept the team from its last mission, by the last round."""
    if not run.rounds:
        return Blame("")
    state, spacing = run.states[run.rounds], float(run.mission_at(run.rounds).mission["spacing"])
    awake = [robot for robot, phase in enumerate(state.phases) if phase not in SILENT]
    groups = _groups(run, awake)
    without = [robot for robot in awake if state.plan_ids[robot] is None]
    owners = Counter((state.plan_ids[robot], state.slots[robot]) for robot in awake)
    shared = [
        robot
        for robot in awake
        if state.slots[robot] is not None and owners[state.plan_ids[robot], state.slots[robot]] > 1
    ]
    away = [robot for robot in awake if _far(state.positions[robot], state.goals[robot]) > AT_GOAL * spacing]
    largest = groups[0][1] if groups else []
    # Where no plan has most of the robots, none of them stands apart from the team.
    most = 2 * len(largest) > len(awake) - len(without)
    strays = [robot for _, held in groups[1 if most else 0 :] for robot in held] if len(groups) > 1 else []
    if run.accused:
        return Blame(_accused_blame(run), tuple(sorted(run.accused)))
    bad = sorted({*without, *strays, *shared, *away} & {robot for robot in awake if hopeless(run, robot)})
    if bad:
        return Blame(_model_blame(run, bad), tuple(bad))
    dead = _dead(run)
    if dead:
        return Blame(f"{_begun(_deaths_text(run))}, and the others did not fill the formation.", tuple(dead))
    if without:
        return Blame(f"{_begun(robots_text(without))} got no plan.", tuple(without))
    if len(groups) > 1 and _rule(run) == "none":
        # Nobody is to blame but the rule.
        own = "each robot kept its own plan" if len(groups) == len(awake) else "robots kept plans of their own"
        plans = counted(len(groups), "plan")
        return Blame(f"No robot: this protocol has no consensus, so {own}. {plans} were in use at the end.")
    if len(groups) > 1:
        told = [f"{robots_text(held)} had plan {name}" for name, held in groups[:MOST_GROUPS]]
        held = f"{robots_text(sorted(strays))} held another than most" if most else "; ".join(told)
        told_all = "" if most or len(groups) <= MOST_GROUPS else "; and so on"
        plans = f"The team did not agree: {len(groups)} plans were in use at the end; {held}{told_all}."
        return Blame(plans, tuple(sorted(strays)) if most else ())
    if shared:
        return Blame(f"{_begun(robots_text(shared))} claimed a place that another one claimed too.", tuple(shared))
    if away:
        return Blame(f"{_begun(robots_text(away))} had not reached the claimed places.", tuple(away))
    return _plan_blame(run)


def _rule(run: Recording) -> str:
    """The rule by which the team agrees on a plan; empty where the record does not say."""
    return "" if run.info is None else str(run.info.config.get("protocol", {}).get("consensus") or "")


def _groups(run: Recording, awake: Sequence[int]) -> list[tuple[str, list[int]]]:
    """The robots that hold each plan, by its letters; the largest group first."""
    held: defaultdict[str, list[int]] = defaultdict(list)
    plan_ids = run.states[run.rounds].plan_ids
    for robot in awake:
        if plan_ids[robot] is not None:
            held[run.plan_name(plan_ids[robot])].append(robot)
    return sorted(held.items(), key=lambda one: (-len(one[1]), one[0]))


def _accused_blame(run: Recording) -> str:
    told = [
        f"Robot {robot} was accused of sending what no honest robot sends: {run.accused[robot]}"
        for robot in sorted(run.accused)
    ]
    return ". ".join(told[:MOST_GROUPS]) + "."


def _plan_blame(run: Recording) -> Blame:
    """All are at their places: then the places are not those of the shape."""
    steps = run.provenance(0, run.rounds)
    error = run.rows[run.rounds].procrustes_mean
    if not steps or error is None:
        poor = [k for k, phase in enumerate(run.states[run.rounds].phases) if phase not in SILENT and hopeless(run, k)]
        return Blame(_model_blame(run, poor), tuple(poor)) if poor else Blame("No single robot stands out.")
    robot = steps[0].robot
    return Blame(f"Robot {robot} proposed a plan that is {error:.2g} units off the shape, and all flew it.", (robot,))


def hopeless(run: Recording, robot: int) -> bool:
    """Whether at least half of the answers of a robot's model were of no use."""
    tally = run.tallies.get(robot)
    return tally is not None and tally.unusable > 0 and tally.unusable >= HOPELESS * tally.asked


def _model_blame(run: Recording, robots: Sequence[int]) -> str:
    tallies = [run.tallies[robot] for robot in robots]
    unusable, asked = sum(tally.unusable for tally in tallies), sum(tally.asked for tally in tallies)
    whose = "its model" if len(robots) == 1 else "their models"
    last = next((tally.last for tally in reversed(tallies) if tally.last), "")
    quoted = f" The last reason: {last[:LONGEST]}{'…' if len(last) > LONGEST else ''}" if last else ""
    calls = f"{unusable} of {counted(asked, 'call')}"
    return f"{_begun(robots_text(robots))}: {whose} gave no usable answer in {calls}.{quoted}"


def _far(position: Sequence[float], goal: Sequence[float] | None) -> float:
    return 0.0 if goal is None else math.dist(position, goal)


def interesting(run: Recording, found: Blame) -> dict[str, Any]:
    """The robot that the mind panel opens with, and why: the first that is to blame for a run that did not form.

    Without one, the robot with the most refused and failed calls, help by geometry and open circuit breakers; in a run
    without any trouble, the one that proposed the plan in force; else robot 0.
    """
    if found.robots:
        return {"robot": found.robots[0], "why": "it kept the team from forming"}
    worst = max(run.tallies, key=lambda robot: (run.tallies[robot].trouble, -robot), default=None)
    if worst is not None and run.tallies[worst].trouble:
        return {"robot": worst, "why": run.tallies[worst].words}
    proposer = (run.result or {}).get("plan_robot")
    plans = {plan for plan in run.states[run.rounds].plan_ids if plan is not None}
    if not isinstance(proposer, int) and len(plans) == 1:
        steps = run.provenance(0, run.rounds)
        proposer = steps[0].robot if steps else None
    if isinstance(proposer, int) and 0 <= proposer < run.n_robots:
        return {"robot": proposer, "why": "it proposed the plan in force"}
    return {"robot": 0, "why": "nothing stands out"}
