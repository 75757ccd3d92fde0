"""The knowledge and questions of one robot in a round, as plain values.

Pages set all of it as text, so no answer of a model can become markup. No character in it turns or hides text.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from llm_flock.printable import printable
from llm_flock.record import SILENT, LlmEntry, RunHistory, begun, verdict
from llm_flock_view._viewer.events import breaker_text

MAX_CLAIMS = 30

USUAL = "idle"  # phase between two rounds; any other is told

_ORIGINS = {
    "start": "at its start",
    "model": "moved as its model wanted",
    "clipped": "moved as its model wanted, but not beyond a limit",
    "shield": "moved by the safety shield",
    "yield": "moved out of another's way",
    "geometry": "moved by geometry",
    "hold": "stayed where it was",
}
"""The cause of a robot's move in the round, as text."""


class HeardClaim(NamedTuple):
    """The claim of a robot in radio range, with its influence and distance. A rival wants the same place."""

    robot: int
    plan: str
    slot: int | None
    influence: float
    distance: float
    rival: bool


def mind(run: RunHistory, robot: int, number: int) -> dict[str, Any] | None:
    """A robot's plan, its conversation with its model, and the claims it heard; None without such a robot or round."""
    if not (0 <= robot < run.n_robots and 0 <= number <= run.last_round):
        return None
    state = run.states[number]
    plan, slot, phase = state.plan_ids[robot], state.slots[robot], state.phases[robot].replace("_", " ")
    facts = [
        "no plan" if plan is None else f"plan {run.plan_name(plan)}",
        "no place" if slot is None else f"place {slot}",
        f"heard by {state.influence[robot]:.0%} of the team".replace("%", " %"),
        _ORIGINS.get(state.origins[robot], f"moved by {state.origins[robot]}"),
    ]
    if phase != USUAL:
        facts.append(phase)
    calls = tuple(run.calls.get((number, robot), ()))
    found = claims_heard(run, robot, number)
    return {
        "robot": robot,
        "round": number,
        "facts": printable(" · ".join(facts)),
        "breakers": [printable(begun(text)) for text in breakers(run, robot, number)],
        "calls": [_call(entry) for entry in calls],
        "before": None if calls else next((k for k in range(number, -1, -1) if (k, robot) in run.calls), None),
        "provenance": printable(_provenance(run, robot, number)),
        "n_claims": len(found),
        "claims": [
            [
                str(claim.robot),
                claim.plan,
                "-" if claim.slot is None else str(claim.slot),
                f"{claim.influence:.2f}",
                f"{claim.distance:.1f}" + (" · wants the same place" if claim.rival else ""),
            ]
            for claim in found[:MAX_CLAIMS]
        ],
    }


def prompt(run: RunHistory, robot: int, number: int, call: int) -> list[list[str]]:
    """Everything that a model saw in one call: role and text of each message. They are long: asked for when opened."""
    calls = run.calls.get((number, robot), ())
    if not 0 <= call < len(calls):
        return []
    return [[printable(line.role), printable(line.text)] for line in calls[call].messages]


def claims_heard(run: RunHistory, robot: int, number: int) -> list[HeardClaim]:
    """The claims within a robot's radio range in a round, its own first, then the nearest."""
    state = run.states[number]
    reach = float(run.mission_at(number).mission["comm_range"])
    own = state.plan_ids[robot], state.slots[robot]
    found = [
        HeardClaim(
            robot=other,
            plan=run.plan_name(state.plan_ids[other]),
            slot=state.slots[other],
            influence=state.influence[other],
            distance=math.dist(state.positions[robot], state.positions[other]),
            rival=other != robot and own[1] is not None and own == (state.plan_ids[other], state.slots[other]),
        )
        for other in range(len(state.positions))
        if other == robot or state.phases[other] not in SILENT
    ]
    return sorted((c for c in found if c.distance <= reach), key=lambda c: (c.robot != robot, c.distance))


def breakers(run: RunHistory, robot: int, number: int) -> list[str]:
    """A sentence for each circuit breaker of a robot that is open in a round; empty while all are closed."""
    known = [event for k in range(number + 1) for event in run.events.get(k, ()) if event.robot == robot]
    newest = {event.detail.get("question"): event for event in known if event.kind == "breaker"}
    return [breaker_text(event) for event in newest.values() if event.detail.get("state") == "open"]


def _call(entry: LlmEntry) -> dict[str, Any]:
    probe = " · probe" if entry.probe else ""
    return {
        "title": printable(f"{entry.kind} · try {entry.attempt + 1}{probe}"),
        "model": printable(entry.model.replace(",", ", ")),
        "messages": len(entry.messages),
        "answer": None if entry.text is None else printable(entry.text),
        "used": entry.rejected is None and entry.error is None,
        "verdict": printable(verdict(entry)),
        "price": printable(_price(entry)),
    }


def _provenance(run: RunHistory, robot: int, number: int) -> str:
    words = [
        f"robot {step.robot} {'proposed' if step.source is None else 'took'} it (round {step.round})"
        + (", made by geometry" if step.by == "geometry" else "")
        for step in run.provenance(robot, number)
    ]
    return " → ".join(words)


def _price(entry: LlmEntry) -> str:
    """Tokens, time, money and faults of a call."""
    cached = f" ({entry.usage.cached} cached)" if entry.usage.cached else ""
    cost = f" · ${entry.cost_usd:.4f}" if entry.cost_usd else ""
    faults = f" · {', '.join(entry.faults)}" if entry.faults else ""
    return f"{entry.usage.input} tokens in{cached}, {entry.usage.output} out · {entry.latency_s:.2f} s{cost}{faults}"
