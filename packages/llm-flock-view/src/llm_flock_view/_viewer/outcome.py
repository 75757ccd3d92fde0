"""The banner of a run: what came of it, and the robots that kept the team from forming.

The first screen shows it before any click.
"""

from __future__ import annotations

from typing import Any

from llm_flock.record import (
    CallCounts,
    Diagnosis,
    RunHistory,
    begun,
    caveats,
    deaths_text,
    diagnose,
    outcome_of,
    protocol_text,
    work_text,
)


def outcome(run: RunHistory, *, over: bool) -> dict[str, Any]:
    """The banner of a page: see `outcome_of`, `diagnose`; `tone` is good, part (formed, not whole now), bad or open."""
    came = outcome_of(run, over=over)
    formed = came.ending == "formed"
    found = diagnose(run) if over and not formed else Diagnosis()
    return {
        "tone": "good" if came.whole else "part" if formed else "bad" if over else "open",
        "formed": formed,
        "headline": came.headline,
        "protocol": protocol_name(run),
        "why": found.why,
        "by": begun(_work(run, came.missions[-1].formed if over else None)) if formed else "",
        "stood": run.formations,
        "robots": list(found.robots),
        "interesting": interesting(run, found),
        "missions": [part._asdict() for part in came.missions],
    }


def _work(run: RunHistory, since: int | None) -> str:
    """How long the team stood formed if it did so to the end, deaths, and the share of models and geometry."""
    last, work = (
        run.last_round,
        work_text(run.result or {}).replace(",", ", ").replace(",  ", ", "),
    )  # so that it breaks
    stands = since is not None and since < last and run.rows[last].in_order_since is not None
    stood = f"stood from round {since} to the end in round {last}" if stands else ""
    beware = caveats(run.result or {}, run.missions[0].mission) if run.missions else []
    return " · ".join(part for part in (stood, deaths_text(run), *beware, work) if part)


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
