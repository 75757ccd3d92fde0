"""Recorded events as marks on the timeline, and as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from llm_flock.record import MAX_PLACES, ProtocolEvent, counted, robots_text

LARGEST = 1e12  # numbers from here on are not shortened: a record may hold any

_TRACKS = {
    "proposed": "plans",
    "adopted": "plans",
    "void_plan": "plans",
    "fallback": "fallbacks",
    "no_plan": "fallbacks",
    "breaker": "fallbacks",
    "clipped": "shield",
    "shielded": "shield",
    "separating": "shield",
    "deadlock": "shield",
    "gives_way": "shield",
    "evades": "shield",
    "held": "shield",
    "killed": "faults",
    "joined": "faults",
    "accused": "faults",
    "battery": "faults",
    "order": "missions",
    "agreed": "faults",
    "gap": "faults",
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
    after = f"after {counted(refusals, 'refusal')} in a row (circuit breaker open{probe})"
    return f"its model is not asked for a {question} {after}; the last: {detail.get('reason')}"


def in_words(event: ProtocolEvent, plan_name: Callable[[str | None], str]) -> str:
    """An event as a sentence without its subject; `plan_name` gives the letters that stand for a plan."""
    if event.kind in _FLIGHT and (event.kind != "clipped" or "sent" in event.detail):
        return _FLIGHT[event.kind](event.detail)
    sentence = _SENTENCES.get(event.kind)
    if event.kind in _PLAN_SENTENCES:
        return _PLAN_SENTENCES[event.kind](event.detail, plan_name(event.detail.get("plan")))
    if event.kind == "breaker" and event.detail.get("state") == "open":
        return f"does without its model for now: {breaker_text(event)}"
    return _unknown(event) if sentence is None else sentence(event.detail)


Detail = Mapping[str, Any]


def _proposal(detail: Detail, plan: str) -> str:
    by = " made by geometry" if detail.get("by") == "geometry" else ""
    return f"proposed plan {plan}{by}"


def _adoption(detail: Detail, plan: str) -> str:
    return f"took plan {plan} over from robot {detail.get('from')}"


_PLAN_SENTENCES: Mapping[str, Callable[[Detail, str], str]] = {"proposed": _proposal, "adopted": _adoption}


def _claim(detail: Detail) -> str:
    slot, before = detail.get("slot"), detail.get("before")
    if slot is None:
        return "gave its place up" if before is None else f"gave place {before} up"
    return f"claimed place {slot}" + ("" if before is None else f" instead of {before}")


def _fallback(detail: Detail) -> str:
    helper = "geometry" if detail.get("by") == "geometry" else "a neighbour's plan"
    return f"was helped by {helper}, for its model gave no usable {detail.get('question')}{_because(detail)}"


def _rejection(detail: Detail) -> str:
    reason = str(detail.get("reason") or "").replace("_", " ") or "no reason recorded"
    more = detail.get("detail")
    return f"refused a message that it heard: {reason}" + (f" ({more})" if more else "")


_TRIGGERS = {
    "no_answer": "the last question had no usable answer",
    "new_plan": "its plan is another one",
    "new_goal": "its place is another one",
    "altered": "it was not moved as its model wanted",
    "used_up": "it has flown the model's path to its end",
    "obstacle": "an obstacle is near its path",
    "neighbour": "another robot is near its path",
    "unfit": "the rest of the path no longer passes the check",
}


def _asked_again(detail: Detail) -> str:
    reason = str(detail.get("reason"))
    return f"asks its model for a step again: {_TRIGGERS.get(reason, reason.replace('_', ' '))}"


def _search(detail: Detail) -> str:
    vacant = _list(detail.get("vacant"))
    if not detail.get("begun"):
        return "ended its search for the robots that its plan lacks" + (
            f"; still without a robot: {_places(vacant)}" if vacant else ""
        )
    return f"set out to look for robots for {_places(vacant)}" if vacant else "set out to look for missing robots"


def _gap(detail: Detail) -> str:
    slots, missing = _list(detail.get("slots")), _list(detail.get("missing"))
    found = "was" if len(missing) == 1 else "were"
    gone = f", after {robots_text(cast('list[int]', missing))} {found} not found" if missing else ""
    return f"leaves {_places(slots)} of the formation empty{gone}" if slots else "leaves no place empty any more"


def _separating(detail: Detail) -> str:
    near = f" (nearest {_units(detail.get('nearest'))} away)" if detail.get("nearest") is not None else ""
    return ("makes way for robots that stand too close" if detail.get("makes_way") else "leaves a crowd") + near


def _deadlock(detail: Detail) -> str:
    rounds, far = detail.get("rounds"), detail.get("goal_distance")
    some = counted("some" if rounds is None else rounds, "round")
    away = "" if far is None else f", still {_units(far)} away"
    return f"asks for the right of way: others have kept it from its goal for {some}{away}"


def _incident(detail: Detail) -> str:
    whats = {
        "death": "has failed",
        "battery": "has a weak battery",
        "blocked": "has an obstacle in its way",
        "order": "is meant by an order",
    }
    what = whats.get(str(detail.get("about")), "needs a choice")
    return (
        f"noticed that robot {detail.get('robot')} {what}; options: {', '.join(map(str, _list(detail.get('options'))))}"
    )


def _agreed(detail: Detail) -> str:
    votes = detail.get("votes")
    given = cast("Mapping[str, int]", votes if isinstance(votes, Mapping) else {})
    counts = ", ".join(f"{name} {count}" for name, count in given.items())
    choice = f"does what the team chose about robot {detail.get('robot')}: {detail.get('choice')}"
    return f"{choice if counts else 'does as configured'} (votes: {counts or 'none'})"


def _injection(detail: Detail) -> str:
    model, loss = detail.get("model"), detail.get("loss")
    if model is not None:
        return f"had its model replaced from the viewer, by one that answers nonsense: {model}"
    if isinstance(loss, int | float):
        return f"loses {100 * loss:.0f} % of the messages from now on, by order from the viewer"
    return "was disturbed from the viewer"


def _shield(detail: Detail) -> str:
    return f"was led round others by the safety shield{_flown(detail)}"


def _clip(detail: Detail) -> str:
    return f"flew its model's waypoint clipped to the step limit, the goal or the arena{_flown(detail)}"


_SENTENCES: Mapping[str, Callable[[Detail], str]] = {
    "enlarged": lambda detail: "proposed its plan a little larger, so that no two places are too close",
    "no_plan": lambda detail: f"has no plan from its model{_because(detail)}",
    "void_plan": lambda detail: (
        f"follows the plan of robot {detail.get('proposer')} no more, which has signed two different plans"
        + ("" if detail.get("slot") is None else f", and goes back to the one before and its place {detail['slot']}")
    ),
    "fallback": _fallback,
    "breaker": lambda detail: f"has its model asked for a {detail.get('question')} again: its last answer was usable",
    "claimed": _claim,
    "rejected_message": _rejection,
    "asked_again": _asked_again,
    "stale_question": lambda detail: (
        f"asks its model for a {detail.get('about')} again: plan or place changed while it was thinking"
    ),
    "stale_answer": lambda detail: (
        f"dropped its model's {detail.get('about')}: it was about an earlier mission, plan or place"
    ),
    "search": _search,
    "gap": _gap,
    "mission": lambda detail: f"heard of another mission: {detail.get('shape')}",
    "clipped": _clip,
    "shielded": _shield,
    "separating": _separating,
    "deadlock": _deadlock,
    "gives_way": lambda detail: f"gives way to robot {detail.get('to')}",
    "evades": lambda detail: f"steps out of the way of moving obstacle {detail.get('obstacle')}",
    "held": lambda detail: f"stayed where it was{_because(detail)}",
    "clock": lambda detail: f"has a clock that is {detail.get('ahead_s')} s ahead of that of its positions",
    "dropped_notes": lambda detail: f"left {counted(detail.get('count'), 'further event')} out of its report",
    "accused": lambda detail: (
        f"accuses robot {detail.get('robot')} of sending what no honest robot sends: "
        f"{str(detail.get('reason')).replace('_', ' ')}"
    ),
    "battery": lambda detail: f"has a weak battery: it can fly {_units(detail.get('left'))} at most",
    "order": lambda detail: f"got an order in words: {detail.get('words')}",
    "incident": _incident,
    "judged": lambda detail: f"chose {detail.get('choice')} about robot {detail.get('robot')}{_because(detail)}",
    "agreed": _agreed,
    "killed": lambda detail: "died",
    "joined": lambda detail: "joined",
    "injected": _injection,
}


def _seconds(detail: Detail) -> str:
    return "" if detail.get("seconds") is None else f" after {_short(detail['seconds'])} s"


_FLIGHT: Mapping[str, Callable[[Detail], str]] = {
    "take_off": lambda detail: f"was sent up to {_short(detail.get('altitude_m'))} m",
    "aloft": lambda detail: f"reached its altitude{_seconds(detail)}",
    "clipped": lambda detail: f"was sent a shorter move by its driver{_place(', to', detail.get('sent'))}",
    "landing": lambda detail: f"was told to land{_place(' at', detail.get('spot'))}",
    "landed": lambda detail: f"landed{_seconds(detail)}",
    "not_down": lambda detail: (
        "was not seen on the floor in time; its motors " + ("had stopped" if detail.get("stopped") else "were cut")
    ),
    "fell": lambda detail: "fell: its own supervisor stopped its motors in the air",
    "unreachable": lambda detail: f"did not get a command, and is called again{_because(detail)}",
    "given_up": lambda detail: f"can no longer be reached{_place('; it was last sent to', detail.get('position'))}",
    "cut": lambda detail: (
        "had its motors cut, " + ("and confirmed it" if detail.get("confirmed") else "and did not confirm it")
    ),
    "pose_refused": lambda detail: f"was not sent a position from outside{_because(detail)}",
}
"""Flights of real drones, see docs/reference/record.md; where a flight is told by no robot, it is not listed."""


def _unknown(event: ProtocolEvent) -> str:
    """Of a flight, or of another version of the format."""
    details = ", ".join(
        f"{name.replace('_', ' ')} {value}" for name, value in event.detail.items() if value is not None
    )
    return "reports: " + event.kind.replace("_", " ") + (f"; {details}" if details else "")


def _because(detail: Detail) -> str:
    reason = detail.get("reason") or str(detail.get("cause") or "").replace("_", " ")
    return f": {reason}" if reason else ""


def _flown(detail: Detail) -> str:
    return _place(", to", detail.get("flown"))


def _place(before: str, at: object) -> str:
    where = _list(at)
    return f"{before} ({', '.join(_short(part) for part in where)})" if where else ""


def _places(slots: Sequence[object]) -> str:
    """Places by number, twelve at most."""
    some = ", ".join(map(str, slots[:MAX_PLACES])) + (", …" if len(slots) > MAX_PLACES else "")
    return f"place{'s' if len(slots) != 1 else ''} {some}"


def _units(value: object) -> str:
    return f"{_short(value)} unit{'' if value == 1 else 's'}"


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) and abs(value) < LARGEST else str(value)


def _list(value: object) -> list[object]:
    return list(cast("Sequence[object]", value)) if isinstance(value, list | tuple) else []
