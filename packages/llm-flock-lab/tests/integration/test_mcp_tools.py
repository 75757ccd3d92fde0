"""The tools for agents, called by the kit's own client."""

import asyncio
import base64
import json
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcp")
from mcp import Client

from llm_flock_lab._mcp import tools as module
from llm_flock_lab._mcp.records import Records
from llm_flock_lab._mcp.server import make_server

FREE = {"describe_shapes", "fly_mission", "compare_protocols"}
READING = {"list_records", "read_summary", "read_conversation", "draw_figure"}

Call = Callable[..., Coroutine[Any, Any, Any]]


def asked(folder: Path | None, work: Callable[[Client], Coroutine[Any, Any, Any]]) -> Any:
    """What some work with a client in this process returns."""

    async def main() -> Any:
        async with Client(make_server(Records(folder))) as client:
            return await work(client)

    return asyncio.run(main())


def called(folder: Path | None, *calls: tuple[str, dict[str, Any]]) -> list[Any]:
    """The results of calls, one after the other; a name of a record that is "<last>" is that of the last flight."""

    async def work(client: Client) -> list[Any]:
        found: list[Any] = []
        name = ""
        for tool, given in calls:
            filled = json.loads(json.dumps(given).replace("<last>", name))
            found.append(await client.call_tool(tool, filled))
            if tool == "fly_mission" and not found[-1].is_error:
                name = told(found[-1])["record"] or name
        return found

    return asked(folder, work)


def told(result: Any) -> Any:
    return json.loads(result.content[0].text)


def is_picture(content: Any) -> bool:
    return content.mime_type == "image/png" and base64.b64decode(content.data).startswith(b"\x89PNG")


FLIGHT: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "seed": 4}


def test_without_a_folder_no_tool_reads_records(tmp_path: Path) -> None:
    for folder, names in ((None, FREE), (tmp_path, FREE | READING)):
        listed = asked(folder, lambda client: client.list_tools()).tools
        assert {tool.name for tool in listed} == names
        for tool in listed:
            assert tool.description and tool.input_schema["additionalProperties"] is False
            assert tool.annotations.read_only_hint is (tool.name != "fly_mission")
            assert tool.annotations.open_world_hint is False


def test_shapes_are_described_with_the_limits() -> None:
    (result,) = called(None, ("describe_shapes", {}))
    found = result.structured_content
    assert {shape["shape"] for shape in found["shapes"]} >= {"circle", "polygon:K", "star"}
    assert found["limits"]["robots"] == module.MAX_ROBOTS and "geometry" in found["models"]
    assert not any(model.startswith("local") for model in found["models"])


def test_a_flight_is_read_and_drawn_afterwards(tmp_path: Path) -> None:
    name = {"record": "<last>"}
    flown, listed, summary, talk, drawn, several = called(
        tmp_path,
        ("fly_mission", FLIGHT),
        ("list_records", {}),
        ("read_summary", name),
        ("read_conversation", {**name, "robot": 2, "round": 1, "prompts": True}),
        ("draw_figure", {"records": ["<last>"], "rounds": [0, 3]}),
        ("draw_figure", {"records": ["<last>", "<last>"], "kind": "error"}),
    )
    figures = told(flown)
    assert figures["formed"] and figures["simulated"] and len(figures["positions"]) == 3
    assert figures["models"] == ["simulated:ideal"] and figures["why_not_formed"] == ""
    assert told(listed)["records"] == [figures["record"]] == [path.name for path in tmp_path.iterdir()]
    assert told(summary)["result"]["rounds"] == figures["rounds"] == told(summary)["last_rounds"][-1]["round"]
    assert "used" in told(talk)["calls"][0]["verdict"] and told(talk)["calls"][0]["messages"]
    assert [is_picture(result.content[0]) for result in (drawn, several)] == [True, True]


def test_a_flight_without_a_folder_leaves_no_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    one, again = called(None, ("fly_mission", {**FLIGHT, "draw": True}), ("fly_mission", FLIGHT))
    assert told(one)["record"] is None and is_picture(one.content[1]) and len(again.content) == 1
    assert told(one)["positions"] == told(again)["positions"]
    assert not list(tmp_path.iterdir())


def test_a_team_that_fails_is_told_why(tmp_path: Path) -> None:
    (result,) = called(tmp_path, ("fly_mission", {**FLIGHT, "model": "simulated:collapse@1", "rounds": 12}))
    figures = told(result)
    assert not figures["formed"] and "(simulated:collapse@1) gave no usable answer" in figures["why_not_formed"]


def test_own_points_may_be_in_space() -> None:
    points = [[0, 0, 0], [10, 0, 0], [0, 10, 5]]
    (result,) = called(None, ("fly_mission", {"points": points, "kill": "2@3", "rounds": 5}))
    assert told(result)["shape"] == "points" and told(result)["killed"] == ["2@3"]
    assert [len(row) for row in told(result)["positions"]] == [3, 3, 3]


def test_protocols_fly_the_same_seeds() -> None:
    given = {**FLIGHT, "trials": 2, "protocols": ["flock", "baseline"], "model": "simulated:ideal"}
    del given["seed"]
    (result,) = called(None, ("compare_protocols", given))
    one, two = result.structured_content["rows"]
    assert (one["protocol"], two["protocol"]) == ("flock", "baseline")
    assert one["trials"] == two["trials"] == 2 and one["simulated"] and one["formed"]["value"] == 1.0


REAL = ["openai:gpt-5", "local:smollm2", "replay:/etc/passwd", "pathlib:Path", "0=openai:gpt-5,1-2=geometry"]


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    *(("fly_mission", {**FLIGHT, "model": model}, "expected simulated:PROFILE or geometry") for model in REAL),
    ("compare_protocols", {"model": "openai:gpt-5"}, "expected simulated:PROFILE or geometry"),
    ("fly_mission", {"model": "simulated:clever"}, "unknown profile"),
    ("fly_mission", {"shape": "points:/etc/passwd"}, "points: none given"),
    ("fly_mission", {"shape": "blob"}, "unknown shape"),
    ("fly_mission", {"shape": "star", "n_robots": 7}, "a star takes 10, 20"),
    ("fly_mission", {"n_robots": 51}, "less than or equal to 50"),
    ("fly_mission", {"rounds": 301}, "less than or equal to 300"),
    ("fly_mission", {"points": [[0, 0]] * 51}, "at most 50 items"),
    ("fly_mission", {"points": [[0, 0], [1]]}, "coordinates"),
    ("fly_mission", {"arena": 1e308}, "less than or equal to 1000000"),
    ("fly_mission", {"spacing": "nan"}, "spacing"),
    ("fly_mission", {"kill": "all"}, "kill"),
    ("fly_mission", {"robots": 5}, "Extra inputs are not permitted"),
    ("fly_mission", {"out": "/somewhere"}, "Extra inputs are not permitted"),
    ("compare_protocols", {"trials": 21}, "less than or equal to 20"),
    ("compare_protocols", {"protocols": []}, "at least 1 item"),
    ("read_summary", {"record": "../other"}, "a record in the folder of this server"),
    ("read_conversation", {"record": "none", "robot": 0}, "a record in the folder of this server"),
    ("draw_figure", {"records": []}, "at least 1 item"),
    ("take_off", {}, "Unknown tool"),
]


def test_what_is_not_allowed_is_an_error_of_the_tool(tmp_path: Path) -> None:
    results = called(tmp_path, *((tool, given) for tool, given, _ in REFUSED))
    for result, (tool, given, says) in zip(results, REFUSED, strict=True):
        assert result.is_error and says in result.content[0].text, (tool, given)
    assert not list(tmp_path.iterdir())


def test_drawings_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    twice, late = {"records": ["<last>", "<last>"]}, {"records": ["<last>"], "rounds": [99]}
    _, one, two = called(tmp_path, ("fly_mission", FLIGHT), ("draw_figure", twice), ("draw_figure", late))
    assert one.is_error and "one record for snapshots" in one.content[0].text
    assert two.is_error and "rounds of this record" in two.content[0].text


def test_a_mission_ends_when_its_time_is_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT_S", 0.2)
    given = {"n_robots": 30, "spacing": 5, "rounds": 300, "model": "simulated:collapse@1", "protocol": "baseline"}
    late, later = called(tmp_path, ("fly_mission", given), ("compare_protocols", {"trials": 20}))
    for result in (late, later):
        assert result.is_error and "this took longer than 0.2 s and was broken off" in result.content[0].text
