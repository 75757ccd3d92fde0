"""Every kind of event is a sentence: people read it, and no name of a field or value of Python is in it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from sample_records import FakeRun

from llm_flock.events import NOTES
from llm_flock.record._history import RunHistory
from llm_flock.record._schema import ProtocolEvent
from llm_flock_view._viewer.data import event_lines
from llm_flock_view._viewer.events import _PLAN_SENTENCES, _SENTENCES, in_words

VALUES: dict[str, Any] = {
    "plan": "ab12", "asked": "ab12", "slot": 3, "before": None, "from": 2, "by": "model", "question": "step",
    "cause": "refused", "reason": "it is too far", "state": "open", "refusals": 3, "wait": 2, "detail": "who knows",
    "about": "step", "begun": True, "vacant": [0, 1], "slots": [4], "missing": [5], "counter": 1, "digest": "x",
    "proposer": 2, "shape": "cross", "proposed": [1.0, 2.0], "flown": [1.5, 2.25], "nearest": 1.25, "makes_way": False,
    "goal_distance": 4.5, "after": "ab12", "rounds": 3, "to": 6, "count": 12, "robot": 4, "proof": "aGVsbG8=",
    "model": "simulated:collapse", "loss": None, "ahead_s": 3.5, "obstacle": 2,
    "left": 12.5, "words": "hurry", "options": ["leave", "close"], "choice": "close",
    "votes": {"close": 5, "leave": 2},
}  # fmt: skip


def words(kind: str, **changes: Any) -> str:
    detail = {name: VALUES[name] for name in NOTES.get(kind, frozenset())} | changes
    return in_words(ProtocolEvent(round=5, comm_round=0, robot=1, kind=kind, detail=detail), lambda plan: "A")


@pytest.mark.parametrize("kind", sorted(NOTES))
def test_every_kind_of_event_is_a_sentence(kind: str) -> None:
    sentence = "Robot 1 " + words(kind)
    assert re.match(r"Robot 1 [a-z]+ |Robot 1 (died|joined)$", sentence), sentence
    assert not re.search(r"True|False|None|[\[\]{}_=]|ab12|aGVsbG8", sentence), sentence


def test_every_described_kind_is_noted_by_the_protocol() -> None:
    assert _SENTENCES.keys() | _PLAN_SENTENCES.keys() == NOTES.keys()


def test_event_is_described_by_its_details() -> None:
    assert words("search") == "set out to look for robots for places 0, 1"
    assert "ended its search" in words("search", begun=False)
    assert words("claimed", before=1) == "claimed place 3 instead of 1"
    assert words("claimed", slot=None, before=1) == "gave place 1 up"
    assert "again" in words("breaker", state="closed") and "not asked" in words("breaker")
    assert words("agreed") == "does what the team chose about robot 4: close (votes: close 5, leave 2)"
    assert words("agreed", votes={}) == "does as configured (votes: none)"
    assert words("injected", model=None, loss=0.4).startswith("loses 40 % of the messages")
    assert words("shielded").endswith("to (1.5, 2.25)")
    assert words("rejected_message", reason="other_mission", detail="").endswith("it heard: other mission")
    assert words("void_plan").endswith("and goes back to the one before and its place 3")
    assert words("void_plan", after=None, slot=None).endswith("signed two different plans")
    assert words("asked_again", reason="new_goal").endswith("its place is another one")


def test_single_event_is_described_in_the_singular() -> None:
    assert "after 1 refusal in a row" in words("breaker", refusals=1) and "3 refusals" in words("breaker")
    assert "for 1 round," in words("deadlock", rounds=1) and "1 unit away" in words("deadlock", goal_distance=1.0)
    assert words("gap") == "leaves place 4 of the formation empty, after robot 5 was not found"
    assert words("gap", slots=[4, 6], missing=[5, 7]).endswith("empty, after robots 5, 7 were not found")
    assert words("clock", ahead_s=-7200.0) == "has a clock that is -7200.0 s ahead of that of its positions"
    assert words("dropped_notes", count=1) == "left 1 further event out of its report"


FLIGHT_VALUES: dict[str, Any] = {
    "name": "cf1", "altitude_m": 0.5, "seconds": 2.5, "asked": [1.0, 2.0], "sent": [0.5, 1.0], "spot": [1.0, 2.0],
    "stopped": False, "reason": "no answer", "position": [1.0, 2.0, 3.0], "confirmed": True, "landing": True,
}  # fmt: skip


def test_every_kind_of_event_of_a_flight_is_a_sentence() -> None:
    page = (Path(__file__).parents[4] / "docs/reference/record.md").read_text(encoding="utf-8")
    table = page.split("| Kind | What happened | Detail |")[-1].split("\n\n")[0]
    kinds = dict(re.findall(r"^\| `(\w+)` \| .* \| (.*) \|$", table, re.MULTILINE))
    assert len(kinds) > 10
    for kind in kinds.keys() - {"preflight", "returning", "returned", "poses"}:  # these are about no robot
        for values in (FLIGHT_VALUES, {}):
            detail = {name: values[name] for name in re.findall(r"`(\w+)`", kinds[kind]) if name in values}
            event = ProtocolEvent(round=5, comm_round=None, robot=1, kind=kind, detail=detail)
            sentence = in_words(event, lambda plan: "A")
            assert not sentence.startswith("reports"), kind
            assert not re.search(r"True|False|None|[\[\]{}_=]", sentence) or not detail, sentence


def test_unknown_events_are_described_too() -> None:
    assert words("swerved", battery_v=3.2) == "reports: swerved; battery v 3.2"


@pytest.mark.parametrize(
    ("reason", "end"), [("it is too far", "far."), ("it is too far.", "far."), ("why?", "why?"), ("cut …", "cut …")]
)
def test_an_event_ends_with_one_sign(reason: str, end: str) -> None:
    run = RunHistory()
    FakeRun(n=3, rounds=1).write(run)
    detail = {"question": "step", "by": "geometry", "cause": "refused", "reason": reason}
    run.write(ProtocolEvent(round=1, comm_round=0, robot=2, kind="fallback", detail=detail))
    who, said = event_lines(run, 1)["lines"][-1]
    assert who == "robot 2" and said.endswith(end) and not said.endswith("..")
    vacant = ProtocolEvent(
        round=1, comm_round=0, robot=2, kind="search", detail={"begun": True, "vacant": [*range(20)]}
    )
    run.write(vacant)
    assert event_lines(run, 1)["lines"][-1][1].endswith("11, …")
