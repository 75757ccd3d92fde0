"""A part that only looks on ends by its first error, says so in one line, and leaves all else as it was."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from reports import CONFIG, PLACES, N, told

from llm_flock.record import Entry, Guarded, MetricsRow
from llm_flock.runtime import TeamPlanners, open_outputs
from llm_flock_swarm._network import watch
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.swarm import Swarm
from llm_flock_swarm._network.wire import Body, WorldState
from llm_flock_swarm._ros2 import bridge, run
from llm_flock_view._viewer.recording import Recording
from llm_flock_view._viewer.swarm import SwarmSource

SOON = CONFIG.model_copy(
    update={
        "network": CONFIG.network.model_copy(update={"max_s": 0.4}),
        "ros2": CONFIG.ros2.model_copy(update={"router": "tcp/127.0.0.1:1"}),
    }
)


class Kept:
    """A sink that keeps what it gets, and raises if it is told to."""

    def __init__(self, *, raises: bool = False) -> None:
        self.entries: list[Entry] = []
        self.raises = raises

    def write(self, entry: Entry) -> None:
        if self.raises:
            raise ZeroDivisionError("sink\nbroken")
        self.entries.append(entry)


def fails(*_: object) -> None:
    raise ZeroDivisionError("broken")


def watched(sink: Kept | None = None, on_row: Any = None) -> Observer:
    """An observer that has seen a team at its places."""
    now = [50.0]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    seen = Observer(SOON, sink or Kept(), on_row, clock=clock)
    for robot in range(N):
        seen.comes_or_goes(robot, True)
        seen.report(robot, told(robot))
    seen.world(WorldState(stamp=1.0, closest=5.0, bodies=tuple(Body(x, x, 0) for x in PLACES), late=0))
    return seen


def test_a_part_ends_once_and_says_so_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    ended: dict[str, Exception] = {}
    calls: list[int] = []

    def work(number: int) -> None:
        calls.append(number)
        raise ValueError("a line\nand another")

    part, other = Guarded("display", work, ended), Guarded("sink", calls.append, ended)
    for number in range(3):
        part(number)
        other(10 + number)
    assert calls == [0, 10, 11, 12] and list(ended) == ["display"]
    (line,) = caplog.messages
    assert "the display ends here, and the robots fly on" in line and "\n" not in line


def test_display_and_sink_end_alone() -> None:
    sink = Kept()
    seen = watched(sink, fails)
    seen.check()
    seen.check()
    assert list(seen.ended) == ["display"] and sum(isinstance(entry, MetricsRow) for entry in sink.entries) == 2
    seen = watched(Kept(raises=True))
    seen.check()
    assert list(seen.ended) == ["sink"] and seen.robots == [0, 1, 2]


def launcher(seen: Observer) -> Swarm:
    swarm = Swarm(SOON, None)  # type: ignore[arg-type]  # nothing is started
    swarm.observer = seen
    swarm.pids = {"world": 1, "robot-0": 2}
    return swarm


def test_a_launcher_goes_on_without_its_observer() -> None:
    seen = watched()
    seen.check = fails
    swarm = launcher(seen)
    result = swarm.result(asyncio.run(swarm.run()))
    assert (result.stopped, result.formed, list(result.gave_up)) == ("time", None, ["observer"])


def test_a_launcher_that_sees_says_whether_it_formed() -> None:
    swarm = launcher(watched(Kept(raises=True), fails))
    result = swarm.result(asyncio.run(swarm.run(lambda _: False)))
    assert result.formed is True and sorted(result.gave_up) == ["display", "sink"]


def test_a_recorder_ends_with_its_record() -> None:
    """It does nothing else; its exit code is in the launcher's result."""
    with pytest.raises(ZeroDivisionError, match="broken"):
        asyncio.run(watch.look(watched(Kept(raises=True))))


class Bridge:
    """A bridge that cannot draw."""

    def __init__(self, *_: object) -> None:
        self.nodes = SimpleNamespace(namespace="/flock", robots=[SimpleNamespace(publisher=lambda *_: None)] * N)
        self.frame = fails

    async def live(self) -> None:
        await asyncio.sleep(60.0)

    def take_poses(self, bodies: object) -> None:
        """Nobody sends any."""

    def close(self) -> None:
        """Nothing is open."""


class Graph:
    """No network."""

    def __init__(self, *_: object) -> None:
        self.closed = False

    def check_free(self, *_: object) -> None:
        """All is free."""

    def close(self) -> None:
        self.closed = True


def test_a_bridge_ends_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "Graph", Graph)
    monkeypatch.setattr(bridge, "Bridge", Bridge)
    seen = watched()

    async def fly() -> None:
        async with bridge.showing(SOON) as show:
            assert show is not None
            show(SOON, seen)
            for stamp in (2.0, 3.0):
                seen.world(WorldState(stamp=stamp, closest=5.0, bodies=tuple(Body(x, x, 0) for x in PLACES), late=0))

    asyncio.run(fly())
    assert list(seen.ended) == ["view in ROS 2"]


@pytest.mark.parametrize("part", ["check", "world"])
def test_the_sensors_of_a_swarm_outlast_their_observer(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where bodies are in ROS, one process is world, bridge and observer."""
    sent: list[str] = []

    class Link:
        def publish(self, kind: str, *_: object) -> None:
            sent.append(kind)

        def close(self) -> None:
            """Nothing is open."""

        listen = watch_alive = declare_alive = lambda *_, **__: None

    class Bodies:
        def __init__(self, *_: object, **__: object) -> None:
            self.missing = ()

        def reading(self) -> WorldState:
            return WorldState(stamp=1.0, closest=5.0, bodies=tuple(Body(x, x, 0) for x in PLACES), late=0)

        def set_point(self, robot: int) -> None:
            """None yet."""

    async def for_a_while(work: Any) -> None:
        with pytest.raises(TimeoutError, match=r"^$"):
            await asyncio.wait_for(work, 0.5)

    for name, fake in (("Graph", Graph), ("Bridge", Bridge), ("SensedBodies", Bodies), ("until_stopped", for_a_while)):
        monkeypatch.setattr(run, name, fake)
    monkeypatch.setattr(run, "open_link", lambda *_: Link())
    monkeypatch.setattr(Observer, part, fails)
    asyncio.run(run._run_sensors(SOON, None, None))
    assert len(sent) > 3


class Team:
    name = "swarm x"
    config = SOON

    def __init__(self, error: Exception | None = None) -> None:
        self._error = error

    async def follow(self, sink: Any) -> None:
        if self._error is not None:
            raise self._error
        seen = watched(sink)
        seen.check()
        seen.check()

    async def give(self, fields: dict[str, object]) -> int:
        raise NotImplementedError


def test_a_viewers_thread_ends_alone(caplog: pytest.LogCaptureFixture) -> None:
    source = SwarmSource(Team(ZeroDivisionError("no\x1b team")), Recording("x", "x", None, live=True))
    source.watch()
    assert source.recording.failure == "no\\x1b team" and not source.recording.open
    assert len(caplog.messages) == 1


def test_a_feed_to_foxglove_ends_alone() -> None:
    source = SwarmSource(Team(), Recording("x", "x", None, live=True))
    source.also = Kept(raises=True)
    source.watch()
    assert source.recording.failure is None and source.recording.history.last_round == 1


def test_a_flight_outlasts_its_sink(tmp_path: Any) -> None:
    ended: dict[str, Exception] = {}
    config = CONFIG.model_copy(update={"trial": CONFIG.trial.model_copy(update={"out": str(tmp_path)})})
    with open_outputs(config, TeamPlanners(config), Kept(raises=True), ended=ended) as (journal, record):
        journal.begin_mission(config.mission, 0, [])  # type: ignore[arg-type]
        journal.begin_mission(config.mission, 1, [])  # type: ignore[arg-type]
    assert list(ended) == ["sink"] and record is not None and (tmp_path / "run.mcap").stat().st_size
