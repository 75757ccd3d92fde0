"""Texts and colours for runs and plans, the same in figures, pages and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from llm_flock.printable import counted, one_line, same_model
from llm_flock.protocol._agreement import PRESET_RULES

if TYPE_CHECKING:
    from llm_flock.record._schema import LlmEntry

MAX_PLACES = 12  # number of places of a plan that are listed

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8B462E", "#7400E8", "#8B74FF", "#B9A25D")
"""Ten colours, any two of which can be told apart with any colour vision; the first six are of Okabe and Ito (2008)."""

NO_PLAN = "#FFFFFF"


def protocol_text(config: Mapping[str, Any]) -> str:
    """The protocol of a run by its name and the differences from it (flock with index assignment), or its rules."""
    fields = cast("Mapping[str, Any]", config.get("protocol") or {})
    name, given = str(fields.get("protocol") or ""), [fields.get("consensus"), fields.get("assignment")]
    if name not in PRESET_RULES:
        return name or " + ".join(str(rule) for rule in given if rule)
    *usual, shield = PRESET_RULES[name]
    words = zip(("consensus", "assignment"), given, usual, strict=True)
    other = [f"{'no' if rule == 'none' else rule} {word}" for word, rule, own in words if rule and rule != own]
    if fields.get("ties") == "lowest-id":
        other.append("ties to the lowest id")
    if isinstance(fields.get("shield"), bool) and fields["shield"] != shield:
        other.append("no shield" if shield else "a shield")
    return f"{name} with {', '.join(other)}" if other else name


def rules_text(consensus: str | None, assignment: str | None, *, shield: bool | None) -> str:
    """Rules as text, after the name of their protocol if they have one: flock (provenance + ...)."""
    rules = f"{consensus} + {assignment}, shield {'on' if shield else 'off'}"
    name = next((name for name, usual in PRESET_RULES.items() if usual == (consensus, assignment, shield)), "")
    return f"{name} ({rules})" if name else rules


ENDINGS: Mapping[str, str] = {
    "formed": "the formation was built",
    "not formed": "all rounds were flown",
    "budget": "a budget was used up first",
    "no plan": "no model proposed an acceptable plan, and none is asked any more",
    "no answers": "no model answered any more",
    "interrupted": "the run was stopped from outside",
    "broke off": "an error ended the run",
}
"""How runs end; each has exactly one of these endings."""


def ending(result: Mapping[str, Any] | None) -> str:
    """How a run ended, one of `ENDINGS`. Without a result it broke off, whatever it had come to."""
    if result is None or result.get("stopped") == "failed":
        return "broke off"
    if result.get("formed"):
        return "formed"
    stopped = str(result.get("stopped")).replace("_", " ")
    return stopped if stopped in ENDINGS.keys() - {"formed"} else "not formed"


def _last_mission(result: Mapping[str, Any]) -> Mapping[str, Any]:
    """The outcome of a run's last mission; empty where the result, which may come from anywhere, has none."""
    missions = result.get("missions")
    last = cast("Sequence[object]", missions)[-1] if isinstance(missions, list | tuple) and missions else None
    return cast("Mapping[str, Any]", last) if isinstance(last, Mapping) else {}


def formed_in(result: Mapping[str, Any]) -> int | None:
    """The round of the run in which its last mission was formed, by its result; None if it was not."""
    if ending(result) != "formed":
        return None
    number = _last_mission(result).get("formed")
    return number if isinstance(number, int) else None


def formed_text(result: Mapping[str, Any], number: int | None = None) -> str:
    """When a team formed, in round `number` if that is not in its result, or after which time a swarm did.

    Empty if it did not.
    """
    time_s, number = result.get("mission_s"), formed_in(result) if number is None else number
    if isinstance(time_s, int | float):
        return f"formed after {time_s:.1f} s"
    return f"formed in round {number}" if number is not None else "formed" if ending(result) == "formed" else ""


def help_text(result: Mapping[str, Any]) -> str:
    """Whether the models of a run that formed had help; the result of a swarm does not say."""
    if result.get("formed_by_models", True):
        return ""
    without = {*cast("Sequence[str]", result.get("models") or ())} == {"geometry"}
    return ", by geometry without models" if without else ", with help for the models"


def verdict(entry: LlmEntry) -> str:
    """Whether an answer was used, rejected, or never came, and why."""
    if entry.error is not None:
        return f"no answer: {entry.error}"
    if entry.rejected is not None:
        return f"refused: {entry.rejected}"
    how = "used" if entry.clipped is None else f"used after clipping ({entry.clipped.rstrip('.')})"
    return f"{how}: {understood(entry.parsed or {})}"


def work_text(result: Mapping[str, Any]) -> str:
    """The suppliers of a run's last plan and of its waypoints; empty for records without them."""
    parts: list[str] = []
    if result.get("plan_robot") is not None:
        taught: object = result.get("plan_taught")
        known = "" if taught is None else ", which was taught it" if taught else ", which was never taught it"
        parts.append(f"plan by robot {result['plan_robot']} ({result.get('plan_by') or 'unknown'}{known})")
    shares = cast("Mapping[str, float]", result.get("waypoint_shares") or {})
    flown = sorted(((share, who) for who, share in shares.items() if share > 0.0), reverse=True)
    if flown:
        parts.append("waypoints by " + ", ".join(f"{who} {100.0 * share:.0f} %" for share, who in flown))
    opened = cast("list[int]", result.get("breakers_opened") or [])
    if opened:
        parts.append("circuit breakers opened for " + robots_text(opened))
    return " · ".join(parts)


def caveats(result: Mapping[str, Any], mission: Mapping[str, Any]) -> list[str]:
    """What the error of a run does not tell: distances, steps that were cut short, models that nobody asked for."""
    from llm_flock.metrics import ROUNDING  # late: takes longer to import than many commands take

    separation, over, off = (result.get(key) for key in ("min_separation", "steps_over_limit", "center_distance"))
    safe, found = mission["safe_distance"], list[str]()
    if separation is not None and separation < safe - ROUNDING:
        found.append(f"robots came as near as {separation:.3f}, below the safe distance {safe:g}")
    if hits := result.get("obstacle_violations"):
        found.append(f"moving obstacles came too near to robots, in {counted(hits, 'round')} of theirs")
    if over:
        found.append(f"{counted(over, 'step')} over the limit ended there")
    if off is not None and off > mission["spacing"] / 10:
        found.append(f"the team is {off:.2f} beside the centre of its mission")
    kind, _, drawn = str((_last_mission(result) or mission).get("shape")).partition(":")
    if kind == "text" and ending(result) == "formed":
        found.append(f"it formed the agreed program; nobody checked that it is {one_line(drawn, 200)}")
    return found + answers_of_others(result.get("models") or (), result.get("answered_by") or ())


def answers_of_others(asked: Sequence[str], answered: Sequence[str]) -> list[str]:
    """A sentence for each model that answered and was not asked for: some servers answer to any name."""
    found = list[str]()
    for name in answered:
        meant = [one for one in asked if one.partition(":")[0] == name.partition(":")[0]]  # none for a replay
        if meant and not any(same_model(one, name) for one in meant):
            found.append(f"the model that answered is {one_line(name, 200)}, not {one_line(', '.join(meant), 200)}")
    return found


def robots_text(robots: Sequence[int]) -> str:
    """Some robots by their ids, twelve at most."""
    return listed("robot", robots)


def listed(what: str, numbers: Sequence[int]) -> str:
    """Some things by their numbers, twelve at most."""
    some = ", ".join(map(str, numbers[:MAX_PLACES])) + (", …" if len(numbers) > MAX_PLACES else "")
    return f"{what}{'s' if len(numbers) > 1 else ''} {some}"


def letters(number: int) -> str:
    """The name of a run's plan, from 0 in the order in which plans were first seen: A .. Z, AA, AB, ..."""
    name = ""
    number += 1
    while number:
        number, rest = divmod(number - 1, 26)
        name = chr(ord("A") + rest) + name
    return name


def begun(text: str) -> str:
    """A text with a capital letter first."""
    return text[:1].upper() + text[1:]


def sentence(text: str, most: int) -> str:
    """A text of at most `most` letters in one line, with a full stop or other sign at its end."""
    text = one_line(text, most).rstrip()
    return text if text.endswith((".", "!", "?", "…")) else f"{text}."


def understood(parsed: Mapping[str, Any]) -> str:
    """The parsed answer as text: the next waypoint and path, or the plan and the slot."""
    words: list[str] = []
    for name, value in parsed.items():
        rows = cast("list[object]", value) if isinstance(value, list) else None
        if name == "waypoint" and rows is not None:
            words.append(f"next waypoint {_place(rows)}")
        elif name == "path" and rows is not None:
            words.append("path " + " → ".join(_place(at) for at in rows))
        elif name == "plan" and rows is not None:
            more = f" and {len(rows) - MAX_PLACES} more" if len(rows) > MAX_PLACES else ""
            places = " ".join(_place(at) for at in rows[:MAX_PLACES])
            words.append(f"a plan of {len(rows)} places: {places}{more}")
        elif name == "slot":
            words.append("no own place" if value is None else f"own place {value}")
        else:
            words.append(f"{name} {value}")
    return "; ".join(words)


def _place(at: object) -> str:
    """A point as people write it; anything else unchanged, because a record may come from anywhere."""
    if not isinstance(at, list):
        return str(at)
    parts = cast("list[Any]", at)
    try:
        return f"({', '.join(f'{round(part, 2):g}' for part in parts)})"
    except (TypeError, OverflowError):  # no number, or a whole number of hundreds of digits
        return str(parts)
