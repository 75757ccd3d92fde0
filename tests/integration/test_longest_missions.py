"""The longest mission that is accepted reaches every robot, and one byte more is refused at every door."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import llm_flock
from llm_flock.bounds import MAX_OBSTACLES, mission_room
from llm_flock.errors import FlockError
from llm_flock.message import Message, MissionStamp, received_mission
from llm_flock.mission import Mission, mission_text
from llm_flock.record import read_record
from llm_flock.runtime import RunConfig
from llm_flock.runtime._orders import RunOrders
from llm_flock_swarm._cli.swarm import mission as mission_command
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.watched import WatchedSwarm
from llm_flock_swarm._ros2.orders import MissionGiver, mission_fields
from llm_flock_view._viewer.launcher import Launcher
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.orders import PageOrders, _give

BASE = llm_flock.Mission(n_robots=5)


def room(mission: Mission) -> int:
    return mission_room(mission.n_robots, mission.n_places, mission.dim) - len(mission_text(mission).encode())


def words(more: int = 0) -> dict[str, Any]:
    """A shape in words, which leaves `more` bytes too few."""
    left = room(BASE.change(shape="text:ü")) + more
    return {"shape": "text:ü" + left % 2 * "u" + left // 2 * "ü"}


def points(more: int = 0) -> dict[str, Any]:
    """Points with long coordinates: this many digits each."""
    texts = [[f"{x}.0", f"{y}.0"] for x in range(20, 83, 9) for y in range(10, 80, 7)]
    left = room(BASE.change(points=[[float(x), float(y)] for x, y in texts])) + more
    for row in texts:
        for axis in (0, 1):
            row[axis] = row[axis][:-1] + "1" + "234567891234"[: max(0, left)]
            left -= 12
    assert left < 0, "all places have room for whole numbers only"
    return {"points": [[float(x), float(y)] for x, y in texts]}


def page_error(answer: dict[str, Any]) -> None:
    raise FlockError(f"{answer['field']}: {answer['error']}")


def team_file(fields: dict[str, Any]) -> Path:
    path = Path("team.toml")
    said = {"n_robots": 5, "center": [50.0, 50.0], **fields}
    path.write_text("[mission]\n" + "".join(f"{name} = {json.dumps(value)}\n" for name, value in said.items()))
    return path


def by_ros(fields: dict[str, Any]) -> object:
    giver = MissionGiver.__new__(MissionGiver)
    giver._observer = SimpleNamespace(mission=BASE)  # type: ignore[assignment]
    return giver.give(mission_fields(json.dumps(fields)))


def by_radio(fields: dict[str, Any]) -> object:
    text = json.dumps(fields, ensure_ascii=False)
    stamp = MissionStamp(1, "0" * 16)
    return received_mission(Message(sender=0, sequence=0, degree=0, stamp=stamp, mission_text=text), BASE)


def on_the_page(fields: dict[str, Any]) -> object:
    orders = PageOrders(Library(), Launcher(Library(), Path("runs")))
    asked = {"order": "start", "fields": {"n_robots": 5, **fields}, "pace": 3.0}
    return page_error(asyncio.run(orders.carry_out(asked)))


def steered_on_the_page(fields: dict[str, Any]) -> object:
    run: Any = SimpleNamespace(change=RunOrders(RunConfig(mission=BASE)).change)
    return _give(run, "change", {"fields": fields})


DOORS: dict[str, Callable[[dict[str, Any]], object]] = {
    "Python": lambda fields: BASE.change(**fields),
    "change of a run": lambda fields: llm_flock.run(BASE, rounds=1, changes=[{"round": 1, "robot": 0, "set": fields}]),
    "steering": lambda fields: RunOrders(RunConfig(mission=BASE)).change(fields),
    "page": on_the_page,
    "steering on the page": steered_on_the_page,
    "configuration": lambda fields: SwarmConfig.load(team_file(fields)),
    "mission command": lambda fields: mission_command(
        [f"{name}={value if name == 'shape' else json.dumps(value)}" for name, value in fields.items()],
        config=team_file({}),
    ),
    "watch": lambda fields: asyncio.run(WatchedSwarm(SwarmConfig.load(team_file({}))).give(fields)),
    "ROS": by_ros,
    "radio": by_radio,
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("long", [words, points])
def test_one_byte_more_is_refused(
    door: str, long: Callable[..., dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if long is points and "page" in door:
        pytest.skip("a page takes no points")
    field, most = ("shape", 4535) if long is words else ("points", 1674)
    with pytest.raises(FlockError, match=rf"{field}.* {most:,} bytes .*room for no more.*\(here {most + 1:,}\)"):
        DOORS[door](long(1))


@pytest.mark.parametrize("long", [words, points])
def test_the_longest_mission_reaches_every_robot(long: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    assert room(BASE.change(**long())) == 0
    change = {"round": 8, "robot": 0, "set": long()}
    result = llm_flock.run(
        BASE, model="simulated:ideal", seed=1, rounds=60, start="connected", out=str(tmp_path / "o"), changes=[change]
    )
    assert not result.summary.messages_rejected
    formed = long is points  # a stand-in cannot read words
    assert result.formed is formed and bool(result.summary.missions[1].formed) is formed
    told = {event.robot for event in read_record(tmp_path / "o" / "run.mcap").events if event.kind == "mission"}
    assert told == set(range(5))


def test_obstacles_take_no_room_as_no_message_has_them() -> None:
    discs = [{"center": (0.1 * k, 0.5), "radius": 0.01} for k in range(MAX_OBSTACLES)]
    assert room(BASE.change(obstacles=discs)) == room(BASE)
