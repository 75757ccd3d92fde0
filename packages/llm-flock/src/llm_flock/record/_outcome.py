"""What came of a run, decided and worded once: commands, pages, tables, reports, notebooks and exports all show it.

A result says how a run ended. While there is none, the rounds in order say whether the team stands formed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

from llm_flock.printable import shape_title
from llm_flock.record._diagnosis import AT_GOAL
from llm_flock.record._history import RunHistory
from llm_flock.record._schema import DEAD, SILENT
from llm_flock.record._words import ENDINGS, begun, ending, formed_text, help_text, listed, robots_text


class MissionPart(NamedTuple):
    """One mission of a run: its first round, its last one (None while it is in force), and when it was formed."""

    first: int
    last: int | None
    text: str
    formed: int | None


class RunOutcome(NamedTuple):
    """The outcome of a run, or of its flight so far."""

    ending: str  #: One of `ENDINGS`; empty while the run flies and is not formed.
    headline: str  #: What is true now and what was, as a sentence without a full stop.
    whole: bool  #: Whether it is formed, and now every robot and every place that the whole team could fill is there.
    missions: tuple[MissionPart, ...]


def outcome_of(run: RunHistory, *, over: bool = True) -> RunOutcome:
    """The outcome of a run that has a round, up to its last round. A run that is not `over` flies on."""
    parts = mission_parts(run)
    part, last = parts[-1], run.last_round
    stood = [span for span in run.formations if part.first <= span[0] <= last]
    end = ending(run.result) if over else "formed" if stood and stood[-1][1] >= last else ""
    name = f"Mission {len(parts)} of {len(parts)} ({part.text}) " if len(parts) > 1 else ""
    # A swarm that ended as soon as it had formed stood in no round.
    broken = bool(stood) and run.rows[last].in_order_since is None
    empty, lacks = _empty_places(run)
    now = _empty_text(empty)
    if end == "formed":
        given = f" (given in round {part.first})" if len(parts) > 1 else ""
        when = formed_text(run.result or {}, part.formed)
        if broken:
            when = _until(run, *stood[-1])
        elif before := [span for span in stood if span[0] < (part.formed or 0)]:
            when = f"{_until(run, *before[-1])}; formed again {when.removeprefix('formed ')}"
        words = f"{when}{given}{help_text(run.result or {})}"
    else:
        words = "not formed yet" if not over else f"broke off: {_stopped(run)}"
        words = words if end in ("", "broke off") else f"not formed: {_stopped(run)}"
        if stood:
            words = f"{words}; {_until(run, *stood[-1])}" if over else _until(run, *stood[-1])
        now = now if stood else ""
    whole = end == "formed" and not lacks and not broken
    return RunOutcome(end, begun("; ".join(filter(None, (f"{name}{words}", now)))), whole, tuple(parts))


def mission_parts(run: RunHistory) -> list[MissionPart]:
    """The missions in their order; `formed` is a round of the run, as its result says, or its rounds in order."""
    given, result = list(run.missions), run.result or {}
    told = result.get("missions")
    entries = cast("Sequence[object]", told if isinstance(told, list | tuple) else ())
    parts: list[MissionPart] = []
    for k, info in enumerate(given):
        last = given[k + 1].round - 1 if k + 1 < len(given) else None
        formed = _formed_in(run, info.round, run.last_round if last is None else last)
        if len(entries) == len(given):
            entry = entries[k]
            number = cast("Mapping[str, Any]", entry).get("formed") if isinstance(entry, Mapping) else None
            formed = number if isinstance(number, int) else None
        elif last is None and run.result is not None:
            # The result of a swarm, whose clock is no round, tells of no missions.
            since = formed or run.rows[run.last_round].in_order_since or run.last_round
            formed = since if ending(result) == "formed" else None
        parts.append(MissionPart(info.round, last, shape_text(info.mission), formed))
    return parts


def _formed_in(run: RunHistory, first: int, last: int) -> int | None:
    """Since when the team that stands formed at last has done so, by its rounds in order; mere disorder is no end."""
    number = None
    for since, until in reversed(run.formations):
        if first <= since <= last and (number is None or run.states[until].plan_ids == run.states[number].plan_ids):
            number = since
        elif since < first or number is not None:
            break
    return number


def shape_text(mission: Mapping[str, Any]) -> str:
    """The shape and its number of places, and the number of robots where it is another one."""
    n, places = mission["n_robots"], mission.get("places")
    shape = shape_title(str(mission["shape"]))
    return f"{shape} of {n}" if places in (None, n) else f"{shape} of {places}, {n} robots"


def _until(run: RunHistory, first: int, last: int) -> str:
    """In which rounds the team stood formed, and what ended that."""
    if last >= run.last_round:
        return f"formed since round {first}"
    return f"formed in rounds {first} to {last}, then {_change(run, last + 1)}"


def _change(run: RunHistory, number: int) -> str:
    """What happened in a round that ended a formation."""
    before, state = run.states[number - 1], run.states[number]
    phases = list(zip(before.phases, state.phases, strict=True))
    died = [robot for robot, (was, now) in enumerate(phases) if now == DEAD != was]
    joined = [robot for robot, (was, now) in enumerate(phases) if was in SILENT and now not in SILENT]
    if died or joined:
        return f"{robots_text(died)} died" if died else f"{robots_text(joined)} joined"
    if before.plan_ids != state.plan_ids:
        return "the team took another plan"
    near = AT_GOAL * float(run.mission_at(number).mission["spacing"])
    ways = enumerate(zip(state.goals, state.positions, state.phases, strict=True))
    away = [k for k, (goal, at, now) in ways if now not in SILENT and goal is not None and math.dist(goal, at) > near]
    if away:
        return f"{robots_text(away)} left {'its place' if len(away) == 1 else 'their places'}"
    return "the plan no longer fitted the team"


def _empty_places(run: RunHistory) -> tuple[list[int], bool]:
    """Places of the one plan in use that no living robot has, and whether these are more than if all robots lived."""
    state, n_robots = run.states[run.last_round], run.n_robots
    awake = [robot for robot, phase in enumerate(state.phases) if phase not in SILENT]
    plans = {state.plan_ids[robot] for robot in awake}
    plan = run.plans.get(next(iter(plans)) or "") if len(plans) == 1 else None
    if plan is None:
        return [], False
    empty = sorted({*range(len(plan.points))} - {state.slots[robot] for robot in awake})
    return empty, len(empty) > max(0, len(plan.points) - n_robots)


def _empty_text(places: Sequence[int]) -> str:
    return f"{listed('place', places)} {'are' if len(places) > 1 else 'is'} empty" if places else ""


def _stopped(run: RunHistory) -> str:
    """Why a run ended."""
    if run.result is None:
        return "the record ends early"
    stopped, flown, end = str(run.result.get("stopped", "ended early")), run.last_round, ending(run.result)
    if stopped == "rounds" and flown < 2:
        return "the only round was used up" if flown else "no round was flown"
    reason = run.result.get("reason")
    rounds = f"all {flown} rounds were used up" + (f"; {reason}" if reason else "")
    other = {"rounds": rounds, "time": "its time was over", "ended": "no robot was left"}
    return other.get(stopped, stopped if end == "not formed" else ENDINGS[end])
