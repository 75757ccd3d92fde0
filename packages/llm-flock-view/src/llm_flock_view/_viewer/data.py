"""JSON for the canvases of a page: one run's rounds and measurements, by its key."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from pydantic_core import to_json

from llm_flock.printable import printable
from llm_flock.record import ASLEEP, DEAD, RunHistory, State, sentence, shape_text
from llm_flock_view._figures.style import plan_look
from llm_flock_view._viewer.events import in_words
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.mind import mind, prompt
from llm_flock_view._viewer.outcome import outcome
from llm_flock_view._viewer.recording import Recording, box
from llm_flock_view._viewer.run_rows import run_row

DECIMALS = 3
BENT = frozenset({"clipped", "shield", "yield", "detour", "geometry"})
"""Origins of waypoints that differ from what the model asked for."""

MAX_FRAMES = 256
MAX_EVENTS = 100
"""Most events of a round that are listed."""

MAX_WORDS, MAX_TOLD_LENGTH = 400, 4_000  # longest event in a page that holds its run, and in the viewer [characters]
LARGEST = 10_000_000  # largest number that a request may contain

FIGURES = (
    "procrustes_mean",
    "plans_in_use",
    "distinct_goals",
    "segment_separation",
    "model_calls",
    "cost_usd",
    "in_order_since",
)
"""Measurements for the plots and the words about a round, by their names in the record."""


def answer(library: Library, path: str, query: Mapping[str, str]) -> bytes | None:
    """The JSON for a path such as /data/1/news; None if there is no such path. Invalid numbers get their defaults."""
    parts = path.strip("/").split("/")
    if parts == ["data", "runs"]:
        changes, runs = library.changes, list(library.runs.values())
        same = query.get("seen") == str(changes) and not any(run.open for run in runs)
        return to_json({"changes": changes, "rows": None if same else [run_row(run) for run in runs]})
    run = library.runs.get(parts[1]) if len(parts) == 3 and parts[0] == "data" else None
    if run is None:
        return None

    def number(name: str, default: int = 0) -> int:
        given = query.get(name, "")
        return min(int(given), LARGEST) if given.isascii() and given.isdigit() and len(given) < 20 else default

    match parts[2]:
        case "mind" | "events" | "prompt" if not run.ready:
            return b"null"
        case "mind":
            return to_json(mind(run.history, number("robot"), number("round")))
        case "prompt":
            return to_json(prompt(run.history, number("robot"), number("round"), number("call")))
        case "events":
            if words := query.get("find", "").lower().split():
                return to_json(events_with(run.history, words))
            return to_json(event_lines(run.history, number("round"), MAX_TOLD_LENGTH))
        case "about":
            return to_json(about(run))
        case "news":
            return to_json(news(run, number("rounds"), number("plans"), number("missions")))
        case "frames":
            return to_json(frames(run.history, number("first"), number("count", 1)))
        case _:
            return None


def about(run: Recording) -> dict[str, Any]:
    """The data that a page needs before the first round; while there is none, the reason."""
    if not run.ready:
        return {"ready": False, "failure": run.failure}
    history = run.history
    fields = history.missions[0].mission
    return {
        "ready": True,
        "live": run.live,
        "about": run.description,
        "simulated": history.info is not None and history.info.simulated,
        "export": run.path is not None,
        "robots": history.n_robots,
        "space": len(fields["arena"][0]) > 2,
        **{name: fields[name] for name in ("safe_distance", "comm_range", "spacing")},
        "downwash": fields.get("downwash", 1.0),
        "arena": [list(corner) for corner in fields["arena"]],
        "obstacles": [dict(obstacle) for obstacle in fields.get("obstacles", ())],
    }


def news(run: Recording, rounds: int, plans: int, missions: int) -> dict[str, Any]:
    """Everything but the robots after the rounds (the start counted), plans and missions that the page knows."""
    history = run.history
    last = history.last_round
    rows = history.rows[rounds : last + 1]
    return {
        "last": last,
        "open": run.open,
        "failure": run.failure,
        "extent": run.extent,
        "formation": box([*history.states[last].positions, *history.states[last].goals]) if last >= 0 else [],
        "outcome": _printable(outcome(history, over=not run.open)) if run.ready else None,
        "steer": None if run.steer is None else run.steer(),
        "plans": [plan_look(number) for number in range(plans, len(history.plan_numbers))],
        "missions": [{"round": m.round, "text": printable(shape_text(m.mission))} for m in history.missions[missions:]],
        "figures": {name: [_round(getattr(row, name)) for row in rows] for name in FIGURES},
        "marks": {str(k): dict(run.marks[k]) for k in range(rounds, last + 1) if k in run.marks},
    }


def frames(run: RunHistory, first: int, count: int) -> list[dict[str, Any]]:
    """The robots in at most MAX_FRAMES rounds; fewer where the run has fewer."""
    end = min(first + min(count, MAX_FRAMES), run.last_round + 1)
    return [_frame(run, run.states[k]) for k in range(max(0, first), end)]


def _frame(run: RunHistory, state: State) -> dict[str, Any]:
    return {
        "r": state.round,
        "x": [[round(part, DECIMALS) for part in row] for row in state.positions],
        "g": [None if row is None else [round(part, DECIMALS) for part in row] for row in state.goals],
        "p": [-1 if plan_id is None else run.plan_numbers[plan_id] for plan_id in state.plan_ids],
        "s": list(state.slots),
        "i": [round(share, 2) for share in state.influence],
        "d": [robot for robot, phase in enumerate(state.phases) if phase == DEAD],
        "z": [robot for robot, phase in enumerate(state.phases) if phase == ASLEEP],
        "h": [
            robot
            for robot, origin in enumerate(state.origins)
            if origin in BENT and not (origin == "geometry" and run.without_models)
        ],
        "b": [k for k, kinds in enumerate(state.open_breakers) if "step" in kinds or (kinds and not state.plan_ids[k])],
    }


def events_with(run: RunHistory, words: Sequence[str]) -> dict[str, Any]:
    """The first MAX_EVENTS events of all rounds whose sentences hold all words, in lower case; each with its round."""
    lines: list[list[Any]] = []
    for number in sorted(run.events):
        for event in run.events[number]:
            line = [f"robot {event.robot}", sentence(in_words(event, run.plan_name), MAX_WORDS), number]
            text = f"{line[0]} {line[1]}".lower()
            # A number is meant as a whole: 7 is robot 7, and no coordinate with a 7 in it.
            if all(word in (re.split(r"[\s,()]+", text) if word.isdigit() else text) for word in words):
                lines.append(line)
        if len(lines) > MAX_EVENTS:
            return {"round": None, "more": True, "lines": lines[:MAX_EVENTS]}
    return {"round": None, "more": False, "lines": lines}


def event_lines(run: RunHistory, number: int, most: int = MAX_WORDS) -> dict[str, Any]:
    """At most MAX_EVENTS events of a round: robot, and a sentence of at most `most` letters without its subject."""
    listed = tuple(run.events.get(number, ()))
    lines = [[f"robot {event.robot}", sentence(in_words(event, run.plan_name), most)] for event in listed[:MAX_EVENTS]]
    return {"round": number, "total": len(listed), "lines": lines}


def _printable(value: Any) -> Any:
    """The same value with every text in it printable."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {str(name): _printable(one) for name, one in cast("dict[object, Any]", value).items()}
    if isinstance(value, list):
        return [_printable(one) for one in cast("list[Any]", value)]
    return value


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
