"""What the time line marks: recorded events and model calls, sorted into few kinds."""

from __future__ import annotations

from collections.abc import Callable

from llm_flock.record.schema import LlmEntry, ProtocolEvent

_OF_KIND = {
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
"""Lane of each kind of event; other kinds are only listed."""


def lane_of_event(event: ProtocolEvent) -> str | None:
    """The lane that marks an event, None for one that is not marked."""
    if event.kind == "claimed":
        return "swaps" if event.detail.get("before") is not None else None
    return _OF_KIND.get(event.kind)


def lane_of_call(entry: LlmEntry) -> str | None:
    """The lane that marks a model call, None for one that went well."""
    if entry.error is not None:
        return "faults"
    return "retries" if entry.rejected is not None else None


def in_words(event: ProtocolEvent, plan_name: Callable[[str | None], str]) -> str:
    """An event in a sentence.

    Args:
        event: what happened.
        plan_name: the letters that stand for a plan.
    """
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
            told = ", ".join(f"{name} {value}" for name, value in detail.items() if value is not None)
            return event.kind.replace("_", " ") + (f" ({told})" if told else "")
