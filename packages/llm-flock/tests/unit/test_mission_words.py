"""Missions in words: typed drafts, what flies of them, stages that the team enters by itself, edits, and labels."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import llm_flock
from llm_flock.cli import app
from llm_flock.errors import AnswerError, FlockError, InputError, ModelError
from llm_flock.formation import parse_program
from llm_flock.llm import Call, MissionReader, ModelPool, Reply, draft_of, edited
from llm_flock.llm._mission_phrases import mission_words
from llm_flock.message import Message, MissionStamp, received_mission
from llm_flock.mission import OPTIONAL, Mission, build_mission, mission_text
from llm_flock.record import caveats
from llm_flock.runtime import build_config

WIDE = Mission(comm_range=100)


def answer(*stages: Any, **more: Any) -> str:
    parts = [stage if isinstance(stage, dict) and "parts" in stage else {"parts": [stage]} for stage in stages]
    return json.dumps({"answer": "mission", "stages": parts, **more})


def sub_teams(*parts: dict[str, Any]) -> dict[str, Any]:
    return {"parts": list(parts)}


LEFT = {"who": {"count": 3, "side": "left"}, "shape": "triangle", "center": [30, 50], "role": "scouts"}
OTHERS = {"shape": "line", "point": "north", "center": [60, 50], "spacing": 6}


@pytest.mark.parametrize(
    ("given", "fields"),
    [
        (answer({"shape": "wedge", "point": "east"}, robots=7), {"shape": "wedge", "turn": -90.0, "n_robots": 7}),
        (answer({"shape": "line", "point": "north"}), {"turn": 90.0}),
        (answer({"shape": "polygon:5", "point": "north"}), {"turn": 90.0}),
        (answer({"shape": "text:a heart", "point": "west"}), {"shape": "text:a heart, pointing west", "turn": None}),
        (answer({"shape": "line", "size": 45}), {"spacing": 5.0}),
        (answer({"who": {"count": 4}, "shape": "square"}), {"places": 4}),
        (answer({"shape": "circle", "velocity": [1, 0]}), {"velocity": [1.0, 0.0]}),
        (answer({"parts": [{"shape": "circle"}], "hold": 5}), {"hold": 5}),
        (answer({"shape": "circle"}, prefer=[{"robot": 3, "way": "edge"}]), {"prefer": [{"robot": 3, "way": "edge"}]}),
        (answer({"shape": "circle"}, {"parts": [{"shape": "line"}], "when": {"round": 40}}), {"shape": "circle"}),
    ],
)
def test_an_answer_sets_the_fields_that_it_says(given: str, fields: dict[str, Any]) -> None:
    found = {**draft_of(given).fields}
    found["prefer"] = [{name: value for name, value in one.items() if value is not None} for one in found["prefer"]]
    assert fields.items() <= found.items()
    json.dumps(found, allow_nan=False)


def test_a_circle_gets_the_diameter_that_was_said() -> None:
    ideal = np.array(draft_of(answer({"shape": "circle", "size": 30}, robots=7)).mission.ideal)
    assert np.linalg.norm(ideal - 50, axis=1) == pytest.approx(15.0)


def test_sub_teams_are_groups_at_their_places() -> None:
    draft = draft_of(answer(sub_teams(LEFT, OTHERS), robots=9), WIDE)
    ideal = np.array(draft.mission.ideal)
    assert ideal[:3].mean(axis=0) == pytest.approx([30, 50], abs=1e-3)
    assert ideal[3:].mean(axis=0) == pytest.approx([60, 50], abs=1e-3)
    assert ideal[3:, 0] == pytest.approx(60.0, abs=1e-3), "from south to north"
    said = "3 robots (those farthest west) as scouts: triangle around 30, 50, size 10, 6 robots (the others): line"
    assert said in draft.in_words


@pytest.mark.parametrize(
    ("given", "cause"),
    [
        (json.dumps({"answer": "ask", "about": "shape", "because": "Which box?"}), "asks about shape: Which box"),
        (json.dumps({"answer": "refuse", "because": "It cannot lift."}), "refuses: It cannot lift"),
        (json.dumps({"answer": "mission"}), "at least one stage"),
        (answer({"shape": "octopus"}), "unknown shape"),
        (answer({"shape": "points:/etc/passwd"}), "a shape with a name"),
        (answer({"shape": "triangle"}), "a triangle takes"),
        (answer({"shape": "circle", "spacing": 1}), "safe_distance"),
        (answer({"shape": "circle", "center": [500, 50]}), "inside the arena"),
        (answer({"shape": "circle", "velocity": [4, 0]}), "max_step / 2"),
        (answer({"shape": "circle", "size": 10, "spacing": 9}), "the width that 10 robots need"),
        (answer({"shape": "line", "fill": True}), "the outline is open"),
        (answer({"shape": "circle", "point": "east", "turn": 5}), "point or turn, not both"),
        (answer({"parts": [{"shape": "circle"}], "when": "order"}), "the first begins at once"),
        (answer({"who": {"side": "left"}, "shape": "circle"}), "a number for a single part|a number of robots"),
        (answer({"who": {"ids": [3, 12]}, "shape": "line"}), "robots from 0 to 9"),
        (answer(sub_teams({**LEFT, "velocity": [1, 0]}, OTHERS)), "the same for all parts"),
        (answer(sub_teams({**LEFT, "shape": "text:a cat"}, OTHERS)), "letters:TEXT"),
        (answer(sub_teams({**LEFT, "who": {"count": 10}}, OTHERS)), "at most the 10"),
        (answer(sub_teams({**LEFT, "center": [58, 50]}, OTHERS)), "places of two groups"),
        (answer(sub_teams(LEFT, OTHERS)), "comm_range"),
        (answer({"shape": "text:", "point": "south"}), "words after text"),
        (answer(sub_teams(LEFT | {"who": {"ids": [1, 2, 3]}}, OTHERS | {"who": {"ids": [3, 4]}})), "each robot in one"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_why(given: str, cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        draft_of(given, WIDE if "of two groups" in cause else None)


FAR = answer(LEFT, {"parts": [OTHERS], "when": {"round": 10**30}})


@pytest.mark.parametrize("given", ["", "no", '{"answer": "maybe"}', '{"answer": "mission", "out": "/x"}', FAR])
def test_an_answer_of_another_form_is_no_draft(given: str) -> None:
    with pytest.raises(AnswerError, match="not of the form"):
        draft_of(given)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (answer({"shape": "circle"}, robots=True), r"robots = True: expected a whole number"),
        (answer({"shape": "circle", "turn": "90"}), r"parts\.0\.turn = '90': expected a number"),
        (answer({"shape": "circle", "center": [True, 50]}), r"center\.0 = True: expected a number"),
        (answer({"shape": "circle", "spacing": float("inf")}), r"spacing = inf: expected a finite number"),
        (answer({"shape": "circle", "fill": 1}), r"fill = 1: expected true or false"),
        (answer({"parts": [{"shape": "circle"}], "hold": "5"}), r"hold = '5': expected a whole number"),
        (answer({"who": {"count": True}, "shape": "circle"}), r"who\.count = True: expected a whole number"),
        (answer({"shape": "circle"}, keep_out=[{"center": [9, 9], "radius": True}]), r"radius = True: expected a num"),
    ],
)
def test_text_and_truths_are_no_numbers_of_a_draft(given: str, says: str) -> None:
    with pytest.raises(AnswerError, match=says):
        draft_of(given)


@pytest.mark.parametrize("more", [{"robots": 5}, {"gaps": "replan"}, {"keep_out": [{"center": [9, 9], "radius": 2}]}])
def test_no_order_in_flight_changes_what_is_the_robots_own(more: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="before they start"):
        draft_of(answer({"shape": "line"}, **more), flying=True)


def test_what_is_not_said_in_flight_stays_as_it_is() -> None:
    flown = Mission(shape="circle", center=(40, 60), spacing=8, turn=None)
    draft = draft_of(answer({"shape": "wedge"}), flown, flying=True)
    assert (draft.mission.center, draft.mission.spacing, draft.mission.shape) == ((40, 60), 8, "wedge")
    later = draft_of(answer({"parts": [{"shape": "line"}], "when": "order"}), flown, flying=True)
    assert later.mission.shape == "circle" and later.mission.following().shape == "line"


@pytest.mark.parametrize("words", ["a circle", "wider"])
def test_what_was_confirmed_is_flown_after_another_order(words: str, table: str) -> None:
    flown = Mission(shape="square", n_robots=8, spacing=8)
    reader = MissionReader(table)
    draft = asyncio.run(reader.edit(words, flown) if words == "wider" else reader.read(words, flown, flying=True))
    meanwhile = flown.change(shape="line", center=(40, 50), velocity=(1, 0), spacing=9, places=7, turn=30)
    assert meanwhile.change(**draft.fields) == draft.mission
    assert flown.change(**draft.fields) == draft.mission


def test_a_formation_that_travels_goes_on_from_where_it_is() -> None:
    flown = Mission(center=(40, 50), velocity=(1, 0))
    assert "center" not in draft_of(answer({"shape": "circle"}), flown, flying=True).fields
    assert draft_of(answer({"shape": "circle", "center": [60, 50]}), flown, flying=True).fields["center"] == [60, 50]


def test_every_field_that_is_flown_is_said() -> None:
    base = build_mission(shape="circle", n_robots=12, comm_range=100, spacing=7)
    said = {mission_words(base)}
    changes: dict[str, Any] = {
        "shape": "line", "center": (40, 50), "spacing": 9, "places": 10, "velocity": (1, 0), "turn": 30, "hold": 4,
        "n_robots": 11, "obstacles": ({"center": (90, 90), "radius": 3},), "prefer": ({"robot": 3, "way": "edge"},),
        "then": ({"set": {"shape": "line"}},), "points": tuple((9.0 * k, 0.0) for k in range(9)),
    }  # fmt: skip
    own = {"since", "safe_distance", "downwash", "max_step", "comm_range", "sense_range", "arena"}
    assert changes.keys() | own == Mission.model_fields.keys()
    for field, value in changes.items():
        shape = {"shape": "points"} if field == "points" else {}
        said.add(mission_words(build_mission(**{**base.model_dump(), "places": None, **shape, field: value})))
    for gaps in ("replan", "report"):
        said.add(mission_words(base, gaps))
    assert len(said) == len(changes) + 3


@pytest.mark.parametrize(
    ("part", "says"),
    [
        ({"shape": "triangle", "point": "north"}, "upright as drawn"),
        ({"shape": "triangle", "point": "east"}, "turned by -90 degrees"),
        ({"shape": "polygon:3", "turn": 300}, "turned by -60 degrees"),
        ({"shape": "wedge", "point": "east"}, "turned by -90 degrees"),
        ({"shape": "text:a heart (no: an X)", "point": "south"}, "a heart (no: an X), pointing south around"),
        ({"shape": "line", "velocity": [0.004, 0]}, "travelling by 0.004, 0 a round"),
    ],
)
def test_words_say_what_is_flown(part: dict[str, Any], says: str) -> None:
    said = draft_of(answer(part, robots=9), WIDE).in_words
    assert says in said and ("any orientation" not in said or part["shape"] == "line")


# ---------------------------------------------------------------- what flies


EDGE: Any = {"robot": 1, "way": "edge"}
STAGES: Any = ({"set": {"shape": "line", "turn": 90, "hold": 4}}, {"set": {"shape": "wedge"}})


@pytest.mark.parametrize("seed", range(3))
def test_the_left_three_and_named_robots_get_their_group(seed: int) -> None:
    def west_group(who: dict[str, Any], place: list[float]) -> tuple[set[int], set[int]]:
        part = {"who": who, "shape": "triangle", "center": place, "spacing": 8}
        other = {**OTHERS, "center": [20, 50] if place[0] > 50 else [80, 50]}
        draft = draft_of(answer(sub_teams(part, other), robots=9), WIDE)
        flown = llm_flock.run(draft.mission, seed=seed, trace=False)
        assert flown.formed
        near = np.linalg.norm(flown.positions[-1] - np.array(place), axis=1) < 10
        return set(np.flatnonzero(near).tolist()), set(np.argsort(flown.positions[0][:, 0])[:3].tolist())

    there, leftmost = west_group({"count": 3, "side": "left"}, [80, 50])
    assert there == leftmost, "although their place is on the right"
    assert west_group({"ids": [0, 4, 7]}, [20, 50])[0] == {0, 4, 7}


@pytest.mark.parametrize(
    ("fields", "cause"),
    [
        ({"then": ({"set": {"n_robots": 3}},)}, "expected only center"),
        ({"then": ({"set": {"shape": "octopus"}},)}, "unknown shape"),
        ({"turn": 10, "shape": "text:a cat"}, "say in the words"),
        ({"prefer": ({"robot": 99, "way": "edge"},)}, "robots from 0 to 9"),
        ({"prefer": ({"robot": 1},)}, "robot and group"),
        ({"protocol": "paper", "then": STAGES}, "auction"),
        (
            {"n_robots": 257, "center": (500, 500), "arena": ((0, 0), (999, 999)), "prefer": (EDGE,)},
            "more than 256 robots",
        ),
        ({"without": "joint-assignment", "prefer": (EDGE,)}, "what preferences are part of"),
        ({"then": STAGES, "changes": ({"round": 3, "robot": 0, "set": {"shape": "line"}},)}, "none beside"),
    ],
)
def test_stages_and_preferences_are_checked_before_the_run(fields: dict[str, Any], cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        build_config({}, **fields)


@pytest.mark.parametrize("own", [Mission(), Mission(turn=20, hold=3, then=STAGES)])
@pytest.mark.parametrize("sent", [Mission(spacing=9), Mission(turn=30, prefer=(EDGE,), then=STAGES)])
def test_a_mission_arrives_as_it_was_sent(own: Mission, sent: Mission) -> None:
    stamp = MissionStamp(1, sent.digest)
    message = Message(sender=0, sequence=0, degree=0, stamp=stamp, mission_text=mission_text(sent))
    assert received_mission(message, own) == sent


def test_wishes_leave_no_trace_in_missions_without_them() -> None:
    assert not OPTIONAL.keys() & json.loads(Mission().model_dump_json()).keys()


# ---------------------------------------------------------------- the reader

TABLE = {
    "Eight of you, a circle!": json.loads(answer({"shape": "circle"}, robots=8)),
    "a circle": json.loads(answer({"shape": "circle"})),
    "wider": {"draw": [{"shape": "square", "scale": [1.5, 1]}]},
}


@pytest.fixture
def table(tmp_path: Path) -> str:
    (tmp_path / "table.json").write_text(json.dumps(TABLE), encoding="utf-8")
    return f"simulated:reader:{tmp_path / 'table.json'}"


def test_a_simulated_reader_knows_its_sentences_alone(table: str) -> None:
    reader = MissionReader(table)
    draft = asyncio.run(reader.read("  eight of you,\n a circle! "))
    assert draft.mission.n_robots == 8 and draft.in_words.startswith("simulated: 8 robots · a circle")
    for other in ("Nine of you, a circle!", "Nine of you.\n\na circle"):
        with pytest.raises(ModelError, match="knows the sentences of its file only"):
            asyncio.run(reader.read(other))
    for broken in ("no file", "[]", "{"):
        (Path(table.removeprefix("simulated:reader:"))).write_text(broken, encoding="utf-8")
        with pytest.raises(InputError, match="an object of sentences"):
            MissionReader(table)


def test_an_edit_shows_what_changes(table: str) -> None:
    draft = asyncio.run(MissionReader(table).edit("wider", Mission(shape="square", n_robots=8, hold=3, then=STAGES)))
    assert "square scale [1.5, 1.0]" in draft.in_words and "instead of (1) a square" in draft.in_words
    ideal = np.array(draft.mission.ideal)
    assert np.ptp(ideal[:, 0]) == pytest.approx(1.5 * np.ptp(ideal[:, 1]), rel=0.05)
    assert (draft.mission.turn, draft.mission.hold, len(draft.mission.then)) == (0.0, 3, 2)
    with pytest.raises(InputError, match="to be edited"):
        asyncio.run(MissionReader(table).edit("wider", Mission(shape="text:a cat")))


@pytest.mark.parametrize(
    ("said", "drawn"),
    [
        (
            '{"/draw/0/turn": 45}',
            {"draw": [{"shape": "circle", "scale": 2, "turn": 45}, {"shape": "star"}], "size": 50},
        ),
        ('{"/draw/0/scale": null, "/size": null}', {"draw": [{"shape": "circle"}, {"shape": "star"}]}),
        ('{"/draw/0": null}', {"draw": [{"shape": "star"}], "size": 50}),
        ('{"/draw/0": null, "/draw/-": {"text": "A"}}', {"draw": [{"shape": "star"}, {"text": "A"}], "size": 50}),
        (
            '{"/draw/-": {"text": "A"}, "/draw/-": {"text": "B"}, "/draw/0": null, "/draw/0": null, "/size": null}',
            {"draw": [{"text": "A"}, {"text": "B"}]},
        ),
        ('{"draw": [{"shape": "line"}]}', {"draw": [{"shape": "line"}]}),
    ],
)
def test_an_edit_is_a_program_or_changes_by_path(said: str, drawn: dict[str, Any]) -> None:
    program = parse_program({"draw": [{"shape": "circle", "scale": 2}, {"shape": "star"}], "size": 50})
    assert edited(said, program) == parse_program(drawn)


@pytest.mark.parametrize(
    "said",
    [
        '{"/draw/7/turn": 45}',
        '{"/draw/x": null}',
        '{"/draw/-1": null}',
        "{}",
        '{"/turn/0": 1}',
        '{"/size/-": 1}',
        '{"/name": null}',
        '{"/draw/0/turn": 45, "size": 1}',
        '{"/draw/0": null, "/draw/1": null}',
        '{"/": 1}',
        '{"/draw": []}',
        '{"/size": NaN}',
        "[]",
        "{",
    ],
)
def test_an_edit_that_leads_nowhere_is_refused(said: str) -> None:
    with pytest.raises(InputError):
        edited(said, parse_program({"draw": [{"shape": "circle"}, {"shape": "star"}], "size": 50}))


def test_a_rejected_answer_goes_back_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Call] = []

    class Model:
        name = "openai:test"

        async def ask(self, call: Call) -> Reply:
            asked.append(call)
            return Reply(text=answers[len(asked) - 1], model=self.name)

    answers = ["a circle", answer({"shape": "triangle"}), answer({"shape": "circle"})]
    monkeypatch.setattr(ModelPool, "model", lambda *_, **__: Model())
    draft = asyncio.run(MissionReader("openai:test").read("a round"))
    assert draft.mission.shape == "circle" and not draft.in_words.startswith("simulated")
    assert "not of the form" in asked[1].messages[-1].text and "a triangle takes" in asked[2].messages[-1].text
    asked.clear()
    answers = ["no"] * 3
    with pytest.raises(AnswerError, match="not of the form"):
        asyncio.run(MissionReader("openai:test").read("a round"))
    assert len(asked) == 3
    asked.clear()
    answers = [json.dumps({"answer": "ask", "about": "which", "because": "Which round?"})]
    with pytest.raises(InputError, match="asks about which"):
        asyncio.run(MissionReader("openai:test").read("a round"))
    assert len(asked) == 1, "a question to the person is no fault"


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["--words", "Eight of you, a circle!", "--yes"], 0, "a circle around 50, 50"),
        (["--words", "Eight of you, a circle!"], 2, "--yes"),
        (["--words", "something else", "--yes"], 2, "knows the sentences"),
        (["--edit", "wider", "--shape", "square", "--robots", "8", "--yes"], 0, "instead of a square"),
        (["--words", "x", "--edit", "y"], 2, "either --words or --edit"),
        (["--yes"], 2, "has no effect without"),
    ],
)
def test_words_on_the_command_line(flags: list[str], code: int, says: str, table: str) -> None:
    more = ["--reader", table] if len(flags) > 1 else []
    result = CliRunner().invoke(app, ["run", "--no-record", "-q", "--model", "geometry", *flags, *more])
    text = result.output + (str(result.exception) if isinstance(result.exception, FlockError) else "")
    assert says.removeprefix("--") in text
    assert (result.exit_code == 0) == (code == 0)


def test_words_are_never_said_to_be_checked() -> None:
    mission = {"safe_distance": 3.0, "spacing": 10.0, "shape": "text:a heart"}
    assert caveats({"formed": True}, mission) == ["it formed the agreed program; nobody checked that it is a heart"]
    assert not caveats({"formed": False}, mission)
    assert not caveats({"formed": True}, {**mission, "shape": "circle"})


def test_many_stages_cost_as_many_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[Mission] = []
    check = Mission.check_shape
    monkeypatch.setattr(Mission, "check_shape", lambda self: (checked.append(self), check(self))[1])
    draft = draft_of(answer(*({"shape": "circle", "center": [40 + k, 50]} for k in range(20))), WIDE)
    assert "(20) in any" not in draft.in_words and "(20) as soon as" in draft.in_words
    assert len(checked) <= 25, "not the square of them"


def test_words_about_one_robot_are_in_the_singular() -> None:
    says = draft_of(answer({"who": {"count": 9}, "shape": "line"}), WIDE).in_words
    assert "1 robot waits aside" in says
    assert draft_of(answer({"shape": "line"}, robots=1), WIDE).in_words.startswith("1 robot ·")
