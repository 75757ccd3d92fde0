"""The outcome of a run: the missions that were formed, when, and the robots that kept the team from the others.

The first screen shows it before any click.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

from llm_flock.printable import shape_title
from llm_flock.record import (
    IN_SHAPE,
    SILENT,
    CallCounts,
    Diagnosis,
    RunHistory,
    begun,
    caveats,
    counted,
    deaths_text,
    diagnose,
    protocol_text,
    work_text,
)

HELD_ROUNDS = 3

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


def mission_parts(run: RunHistory) -> list[MissionPart]:
    """The missions in their order; `formed` is a round of the run, as its result says, or while it flies, its rows."""
    given = list(run.missions)
    missions = (run.result or {}).get("missions")
    entries = cast(
        "Sequence[object]",
        missions if isinstance(missions, list) and len(cast("list[object]", missions)) == len(given) else (),
    )
    parts: list[MissionPart] = []
    for k, info in enumerate(given):
        last = given[k + 1].round - 1 if k + 1 < len(given) else None
        parts.append(MissionPart(info.round, last, shape_text(info.mission), _formation_round(run, k, entries, last)))
    return parts


def shape_text(mission: Mapping[str, Any]) -> str:
    """The shape and its number of places, and the number of robots where it is another one."""
    n, places = mission["n_robots"], mission.get("places")
    shape = shape_title(str(mission["shape"]))
    return f"{shape} of {n}" if places in (None, n) else f"{shape} of {places}, {n} robots"


def _formation_round(run: RunHistory, k: int, entries: Sequence[object], last: int | None) -> int | None:
    if entries and isinstance(entries[k], dict):
        formed = cast("dict[str, Any]", entries[k]).get("formed")
        return formed if isinstance(formed, int) else None
    since = max(0, run.missions[k].round - 1)
    by_rows = _formed_by_rows(run, run.missions[k].round, min(last or run.last_round, run.last_round))
    if run.result is None or last is not None:
        return by_rows
    # The result is about the last mission only. That of a swarm, whose clock is no round, says no round.
    took = run.result.get("rounds_to_formed")
    formed = since + took if isinstance(took, int) else by_rows or run.last_round
    return formed if run.result.get("formed") else None


def _formed_by_rows(run: RunHistory, first: int, last: int) -> int | None:
    """The first of three rounds in order after the team last changed, as measured: for a run that still flies."""
    held = 0
    since = run.last_disturbance_round if run.last_disturbance_round <= last else 0
    for number in range(max(1, first, since), last + 1):
        row, info = run.rows[number], run.mission_at(number)
        awake = sum(phase not in SILENT for phase in run.states[number].phases)
        close = row.procrustes_mean is None or row.procrustes_mean <= IN_SHAPE * float(info.mission["spacing"])
        order = row.plans_in_use == 1 and row.robots_at_goal >= awake == row.distinct_goals and close
        held = held + 1 if order else 0
        if held == HELD_ROUNDS:
            return number - HELD_ROUNDS + 1
    return None


def outcome(run: RunHistory, *, over: bool) -> dict[str, Any]:
    """The banner of a page: see `mission_parts` and `diagnose`; `tone` is good, bad or open."""
    parts = mission_parts(run)
    last = parts[-1]
    found = diagnose(run) if over and last.formed is None else Diagnosis()
    tone = "good" if last.formed is not None else "bad" if over else "open"
    return {
        "tone": tone,
        "headline": _headline(run, parts, over=over),
        "protocol": protocol_name(run),
        "why": found.why,
        "by": begun(_work(run)) if last.formed is not None else "",
        "robots": list(found.robots),
        "interesting": interesting(run, found),
        "missions": [
            {"first": part.first, "last": part.last, "text": part.text, "formed": part.formed} for part in parts
        ],
    }


def _headline(run: RunHistory, parts: Sequence[MissionPart], *, over: bool) -> str:
    last = parts[-1]
    name = f"Mission {len(parts)} of {len(parts)} ({last.text}) " if len(parts) > 1 else ""
    if last.formed is not None:
        given = f" (given in round {last.first})" if len(parts) > 1 else ""
        return begun(f"{name}formed in round {last.formed}{given}{_help_text(run)}{_gaps(run)}")
    if not over:
        return begun(f"{name}not formed yet")
    return begun(f"{name}not formed: {stop_text(run)}")


def _help_text(run: RunHistory) -> str:
    """Whether the models did it alone; older records do not say."""
    if (run.result or {}).get("formed_by_models", True):
        return ""
    return ", by geometry without models" if run.without_models else ", with help for the models"


def _gaps(run: RunHistory) -> str:
    gaps = (run.result or {}).get("gaps")
    return f", with {counted(gaps, 'place')} empty" if isinstance(gaps, int) and gaps > 0 else ""


def _work(run: RunHistory) -> str:
    """The robots that died, and the share of models and geometry in the work."""
    work = work_text(run.result or {}).replace(",", ", ").replace(",  ", ", ")  # so that a list of faults breaks
    beware = caveats(run.result or {}, run.missions[0].mission) if run.missions else []
    return " · ".join(part for part in (deaths_text(run), *beware, work) if part)


def stop_text(run: RunHistory) -> str:
    if run.result is None:
        return "the record ends early"
    stopped = str(run.result.get("stopped", "ended"))
    if stopped == "rounds" and run.last_round < 2:
        return "the only round was used up" if run.last_round else "no round was flown"
    if stopped == "rounds":
        return f"all {run.last_round} rounds were used up"
    return _STOPPED.get(stopped, stopped)


def protocol_name(run: RunHistory) -> str:
    """The name of the protocol, as everywhere; see `protocol_text`."""
    return "" if run.info is None else protocol_text(run.info.config)


def interesting(run: RunHistory, found: Diagnosis) -> dict[str, Any]:
    """The robot that the mind panel opens with, and why: the first that is to blame for a run that did not form.

    Then the one with the most trouble, one for which something was wrong in the end, the proposer of the plan, robot 0.
    """
    if found.robots:
        return {"robot": found.robots[0], "why": "it kept the team from forming"}
    worst = max(run.call_counts, key=lambda robot: (_problems(run.call_counts[robot]), -robot), default=None)
    if worst is not None and _problems(run.call_counts[worst]):
        return {"robot": worst, "why": _problems_text(run.call_counts[worst])}
    if found.look is not None:
        return {"robot": found.look[0], "why": found.look[1]}
    proposer = (run.result or {}).get("plan_robot")
    plans = {plan for plan in run.states[run.last_round].plan_ids if plan is not None}
    if not isinstance(proposer, int) and len(plans) == 1:
        steps = run.provenance(0, run.last_round)
        proposer = steps[0].robot if steps else None
    if isinstance(proposer, int) and 0 <= proposer < run.n_robots:
        return {"robot": proposer, "why": "it proposed the plan in force"}
    return {"robot": 0, "why": "nothing stands out"}


def _problems(counts: CallCounts) -> int:
    """Number of problems with a robot's model; an opened circuit breaker counts as five."""
    return counts.unusable + counts.fallbacks + 5 * counts.breaker_openings


def _problems_text(counts: CallCounts) -> str:
    """The problems as a phrase."""
    parts = [
        (counts.rejected, "answer was rejected", "answers were rejected"),
        (counts.failed, "call failed", "calls failed"),
        (counts.fallbacks, "time helped", "times helped"),
    ]
    phrases = [f"{count} {one if count == 1 else more}" for count, one, more in parts if count]
    return ", ".join([*phrases, "its circuit breaker opened"] if counts.breaker_openings else phrases)
