"""What one robot knew and asked in a round, as plain values.

Pages set all of it as text, so no answer of a model can become markup. It is printable: it neither turns nor hides.
"""

from __future__ import annotations

from typing import Any

from llm_flock.printable import printable
from llm_flock.record.schema import LlmEntry
from llm_flock.record.words import verdict
from llm_flock.viewer.recording import Recording

MOST_CLAIMS = 30

USUAL = "idle"
"""Phase between two rounds; any other is told."""

_ORIGINS = {
    "start": "at its start",
    "model": "moved as its model wanted",
    "clipped": "moved as its model wanted, but not beyond a limit",
    "shield": "moved by the safety shield",
    "yield": "moved out of another's way",
    "geometry": "moved by geometry",
    "hold": "stayed where it was",
}
"""What moved a robot in the round, in words."""


def mind(run: Recording, robot: int, number: int) -> dict[str, Any] | None:
    """A robot's plan, its conversation with its model, and the claims it heard; None without such a robot or round."""
    if not (0 <= robot < run.n_robots and 0 <= number <= run.rounds):
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
    sentences = run.breakers(number, robot)
    calls = run.calls(number, robot)
    found = run.claims_heard(robot, number)
    return {
        "robot": robot,
        "round": number,
        "facts": printable(" · ".join(facts)),
        "breakers": [printable(text[0].upper() + text[1:]) for text in sentences],
        "calls": [_call(entry) for entry in calls],
        "before": None if calls else run.last_call(number, robot),
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
            for claim in found[:MOST_CLAIMS]
        ],
    }


def prompt(run: Recording, robot: int, number: int, call: int) -> list[list[str]]:
    """Everything that a model saw in one call: role and text of each message. They are long: asked for when opened."""
    calls = run.calls(number, robot)
    if not 0 <= call < len(calls):
        return []
    return [[printable(line.role), printable(line.text)] for line in calls[call].messages]


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


def _provenance(run: Recording, robot: int, number: int) -> str:
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
