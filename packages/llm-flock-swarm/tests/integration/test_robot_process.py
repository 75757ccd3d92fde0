"""A robot's process under faults: bad input is counted and dropped; a robot that cannot go on stops, and says so."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from llm_flock.errors import FlockError, InputError
from llm_flock.members import WORLD
from llm_flock.record._schema import NullWriter
from llm_flock_swarm._network import robot as module
from llm_flock_swarm._network.agent_loop import MAX_FAULTS, MAX_NOTES
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.robot import RobotProcess, run_robot
from llm_flock_swarm._network.swarm import Swarm, run_swarm
from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, Body, RobotReport, WorldState, pack, unpack
from llm_flock_swarm._zenoh import LinkTraffic

N = 3
PLACES = [(50.0, 50.0), (60.0, 50.0), (50.0, 60.0)]
CONFIG = SwarmConfig.build({}, shape="triangle", n_robots=N, model="simulated:ideal", gather_s=0.0, gossip_s=0.04)


class FakeLink:
    """A network with one process on it."""

    def __init__(self) -> None:
        self.traffic = LinkTraffic()
        self.at_hand = b""
        self.handlers: dict[str, Callable[[int, bytes], None]] = {}
        self.sent: list[tuple[str, bytes]] = []

    def listen(self, kind: str, number: int | None, handler: Callable[[int, bytes], None]) -> None:
        self.handlers[kind] = handler

    def publish(self, kind: str, number: int, payload: bytes) -> None:
        self.sent.append((kind, payload))

    def watch_alive(self, n_robots: int, handler: Callable[[int, bool], None]) -> None:
        """Nobody comes."""

    def declare_alive(self, number: int) -> None:
        """Nobody asks."""

    def close(self) -> None:
        """Nothing is open."""

    ahead_s = 0.0

    def see(self) -> None:
        """Send the robot what its sensors see; its clock may be `ahead_s` of theirs."""
        bodies = tuple(Body(position=x, end=x, command=0) for x in PLACES)
        stamp = time.time() - self.ahead_s
        self.handlers["frame"](WORLD, pack(WorldState(stamp=stamp, closest=10.0, bodies=bodies, late=0)))

    def hear(self, position: tuple[float, ...] = PLACES[1], message: bytes = b"nothing") -> None:
        """Send the robot a message of robot 1."""
        said = BeaconedMessage(beacon=Beacon(stamp=time.time(), position=position), message=message)
        self.handlers["say"](1, pack(said))

    def count(self, kind: str) -> int:
        return sum(one == kind for one, _ in self.sent)


def fly(
    act: Callable[[RobotProcess, FakeLink], None], seconds: float = 1.2, *, after: float = 0.0
) -> tuple[FakeLink, BaseException | None]:
    """A robot that flies alone with its sensors; `act` is called once, before it begins or so much later [s]."""
    link = FakeLink()

    async def all_of_it() -> BaseException | None:
        process = RobotProcess(CONFIG, 0, link)  # pyright: ignore[reportArgumentType]
        if not after:
            act(process, link)
        task = asyncio.create_task(process.live())
        acts, end = time.monotonic() + after, time.monotonic() + seconds
        while time.monotonic() < end and not task.done():
            link.see()
            if after and time.monotonic() > acts:
                act(process, link)
                acts = end
            await asyncio.sleep(0.02)
        task.cancel()
        (found,) = await asyncio.gather(task, return_exceptions=True)
        await process.planners.close()
        return None if isinstance(found, asyncio.CancelledError) else found

    return link, asyncio.run(all_of_it())


@pytest.mark.parametrize("ahead_s", [7200.0, -7200.0, 0.3])
def test_a_clock_that_is_hours_off_is_told_once(ahead_s: float) -> None:
    def act(process: RobotProcess, link: FakeLink) -> None:
        link.ahead_s = ahead_s

    link, ended = fly(act)
    reports = [unpack(RobotReport, payload) for kind, payload in link.sent if kind == "report"]
    told = [event.detail for report in reports for event in report.happened if event.kind == "clock"]
    assert ended is None and reports
    assert told == ([{"ahead_s": pytest.approx(ahead_s, abs=0.5)}] if abs(ahead_s) > 1.0 else [])


def raising(*_: Any, **__: Any) -> Any:
    raise ZeroDivisionError("a fault of this program")


def test_a_message_that_meets_a_fault_is_counted_and_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    def act(process: RobotProcess, link: FakeLink) -> None:
        link.see()
        monkeypatch.setattr(process.radio, "beacon", raising)
        monkeypatch.setattr(process.agent_loop, "take_order", raising)
        link.hear()

    link, ended = fly(act)
    assert ended is None and link.traffic.refused == {"fault": 1}
    assert link.count("command") > 1 and link.count("say") > 3
    report = unpack(RobotReport, [payload for kind, payload in link.sent if kind == "report"][-1])
    assert report.rejected["fault"] == 1


def test_control_goes_on_by_sensors_where_beacons_are_at_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def act(process: RobotProcess, link: FakeLink) -> None:
        control = process.body.control

        def only_without_beacons(*arguments: Any) -> Any:
            return raising() if process.radio._heard else control(*arguments)

        monkeypatch.setattr(process.body, "control", only_without_beacons)
        link.see()
        link.hear()
        assert process.radio._heard

    link, ended = fly(act)
    assert ended is None and link.traffic.refused["fault"] == 1 and link.count("command") > 1


def test_a_robot_that_cannot_control_its_body_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    link, ended = fly(lambda process, _: monkeypatch.setattr(process.body, "control", raising))
    assert isinstance(ended, ExceptionGroup) and ended.subgroup(ZeroDivisionError) is not None
    assert link.count("command") == 0


def test_failed_exchanges_are_dropped_too_many_end_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = Counter[str]()

    def sometimes(process: RobotProcess, _: FakeLink) -> None:
        exchange = process.agent_loop.exchange

        def one_in_two() -> None:
            counts["all"] += 1
            if counts["all"] % 2:
                raising()
            exchange()

        monkeypatch.setattr(process.agent_loop, "exchange", one_in_two)

    link, ended = fly(sometimes, 2.0)
    assert ended is None and counts["all"] > MAX_FAULTS, "not in a row"
    assert link.count("say") > 5
    _, ended = fly(lambda process, _: monkeypatch.setattr(process.agent_loop, "exchange", raising), 4.0)
    assert isinstance(ended, ExceptionGroup) and ended.subgroup(FlockError) is not None


def test_the_process_says_why_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(RobotProcess):
        async def live(self) -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(asyncio.to_thread(raising))

    monkeypatch.setattr(module, "RobotProcess", Failing)
    monkeypatch.setattr(module, "open_link", lambda *_: FakeLink())
    with pytest.raises(FlockError, match=r"robot 0 cannot go on, and its body stops: ZeroDivisionError"):
        asyncio.run(run_robot(CONFIG, 0))


def test_flood_of_bad_messages_is_not_logged_one_by_one() -> None:
    def act(process: RobotProcess, link: FakeLink) -> None:
        link.see()
        for _ in range(2 * MAX_NOTES):
            link.hear()

    link, ended = fly(act, after=0.6)
    assert ended is None
    reports = [unpack(RobotReport, payload) for kind, payload in link.sent if kind == "report"]
    told = [event for report in reports for event in report.happened]
    dropped = sum(event.detail["count"] for event in told if event.kind == "dropped_notes")
    assert max(len(report.happened) for report in reports) <= MAX_NOTES + 1
    assert sum(event.kind == "rejected_message" for event in told) + dropped >= 2 * MAX_NOTES


def test_no_error_about_what_observers_are_told_ends_a_robot() -> None:
    def act(process: RobotProcess, _: FakeLink) -> None:
        process.agent_loop.notes.append({"kind": "proposed", "detail": {"plan": object()}})

    link, ended = fly(act)
    assert ended is None and link.traffic.refused["fault"] == 1
    assert [kind for kind, _ in link.sent].count("report") > 1


def test_beacons_of_members_that_are_no_robots_are_refused() -> None:
    def act(_: RobotProcess, link: FakeLink) -> None:
        link.see()
        link.handlers["beacon"](WORLD, pack(Beacon(stamp=1.0, position=PLACES[1])))
        link.handlers["beacon"](1, pack(Beacon(stamp=1.0, position=(1.0, 2.0, 3.0))))

    link, _ = fly(act, 0.1)
    assert link.traffic.refused == {"unknown_id": 1, "wrong_length": 1}


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("model", {"model": "simulated:nonsense"}),
        ("model", {"model": "0-1=simulated:ideal,2=openai:gpt-5"}),
        ("model", {"model": "replay:nowhere.jsonl"}),
        ("consensus", {"consensus": "nonsense"}),
        ("prompts", {"prompts": "nowhere"}),
    ],
)
def test_errors_that_end_each_robot_prevent_the_start(
    field: str, given: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def start(*_: object, **__: object) -> None:
        raise AssertionError("a process has been started")

    monkeypatch.setattr(asyncio, "create_subprocess_exec", start)
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with pytest.raises(InputError) as refused:
        asyncio.run(run_swarm(SwarmConfig.build({}, shape="triangle", n_robots=N, **given)))
    assert refused.value.field == field


def test_a_swarm_without_any_robot_left_ends() -> None:
    async def fly() -> str:
        swarm = Swarm(CONFIG, None)  # type: ignore[arg-type]  # nothing is started
        swarm.observer = Observer(CONFIG, NullWriter())
        swarm.pids = {"world": 1, "robot-0": 2, "robot-1": 3}
        swarm.ended = {"robot-0": 2, "robot-1": -9}
        return await asyncio.wait_for(swarm.run(), 5.0)

    assert asyncio.run(fly()) == "ended"
