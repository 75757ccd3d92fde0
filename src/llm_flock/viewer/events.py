"""Recorded events as marks on the timeline, and in words."""

from __future__ import annotations

from collections.abc import Callable

from llm_flock.record.schema import ProtocolEvent

_TRACKS = {
    "proposed": "plans",
    "adopted": "plans",
    "fallback": "fallbacks",
    "no_plan": "fallbacks",
    "shielded": "shield",
    "separating": "shield",
    "deadlock": "shield",
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


def in_words(event: ProtocolEvent, plan_name: Callable[[str | None], str]) -> str:
    """An event as a sentence without its subject; `plan_name` gives the letters that stand for a plan."""
    detail = event.detail
    match event.kind:
        case "proposed":
            return f"proposed plan {plan_name(detail.get('plan'))}"
        case "adopted":
            return f"took plan {plan_name(detail.get('plan'))} over from robot {detail.get('from')}"
        case "claimed":
            before = detail.get("before")
            swap = "" if before is None else f" instead of {before}"
            return f"claimed place {detail.get('slot')}{swap}"
        case "killed":
            return "died"
        case "joined":
            return "joined"
        case "shielded":
            return "was led round others by the shield"
        case "mission":
            return f"heard of another mission: {detail.get('shape')}"
        case _:
            details = ", ".join(f"{name} {value}" for name, value in detail.items() if value is not None)
            return event.kind.replace("_", " ") + (f" ({details})" if details else "")
