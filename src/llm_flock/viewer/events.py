"""Recorded events as marks on the timeline, and in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from llm_flock.record.schema import ProtocolEvent

_TRACKS = {
    "proposed": "plans",
    "adopted": "plans",
    "fallback": "fallbacks",
    "no_plan": "fallbacks",
    "breaker": "fallbacks",
    "clipped": "shield",
    "shielded": "shield",
    "separating": "shield",
    "deadlock": "shield",
    "gives_way": "shield",
    "held": "shield",
    "killed": "faults",
    "joined": "faults",
    "injected": "faults",
    "rejected_message": "faults",
    "mission": "missions",
}
"""Timeline track of each kind of event; other kinds are only listed."""


def track_of_event(event: ProtocolEvent) -> str | None:
    """The track that marks an event; None for an event that is only listed."""
    if event.kind == "claimed":
        return "swaps" if event.detail.get("before") is not None else None
    return _TRACKS.get(event.kind)


def breaker_text(event: ProtocolEvent) -> str:
    """An open circuit breaker in a sentence without its subject."""
    detail = event.detail
    question, refusals, wait = detail.get("question"), detail.get("refusals"), detail.get("wait")
    probe = "" if wait is None else f"; next probe in round {event.round + int(wait)}"
    return (
        f"its model is not asked for a {question} after {refusals} refusals in a row (circuit breaker open{probe}); "
        f"the last: {detail.get('reason')}"
    )


def _at(point: object) -> str:
    if not isinstance(point, list):
        return "-"
    parts = cast("list[object]", point)
    return "[" + ", ".join(f"{x:.4g}" if isinstance(x, int | float) else str(x) for x in parts) + "]"


def in_words(event: ProtocolEvent, plan_name: Callable[[str | None], str]) -> str:
    """An event as a sentence without its subject; `plan_name` gives the letters that stand for a plan."""
    detail = event.detail
    match event.kind:
        case "proposed":
            by = " made by geometry" if detail.get("by") == "geometry" else ""
            return f"proposed plan {plan_name(detail.get('plan'))}{by}"
        case "adopted":
            return f"took plan {plan_name(detail.get('plan'))} over from robot {detail.get('from')}"
        case "claimed":
            before = detail.get("before")
            swap = "" if before is None else f" instead of {before}"
            return f"claimed place {detail.get('slot')}{swap}"
        case "breaker":
            closed = f"is asked for a {detail.get('question')} again: its last answer was usable"
            return breaker_text(event) if detail.get("state") == "open" else f"its model {closed}"
        case "clipped":
            return f"flew its model's waypoint clipped to the step limit or the goal, to {_at(detail.get('flown'))}"
        case "fallback":
            helper = "geometry" if detail.get("by") == "geometry" else "a neighbour's plan"
            return (
                f"was helped by {helper}, for its model gave no usable {detail.get('question')}: {detail.get('reason')}"
            )
        case "no_plan":
            return f"has no plan from its model: {detail.get('reason')}"
        case "killed":
            return "died"
        case "joined":
            return "joined"
        case "shielded":
            return "was led round others by the shield"
        case "deadlock":
            return "asks for the right of way: others have kept it from its goal for some rounds"
        case "gives_way":
            return f"gives way to robot {detail.get('to')}"
        case "mission":
            return f"heard of another mission: {detail.get('shape')}"
        case _:
            details = ", ".join(f"{name} {value}" for name, value in detail.items() if value is not None)
            return event.kind.replace("_", " ") + (f" ({details})" if details else "")
