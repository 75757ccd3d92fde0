"""The deadman: when it takes over, and what it does then."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from flights import STARTS, flight_config

from llm_flock.record._schema import NullWriter
from llm_flock.robots._base import RobotError
from llm_flock.robots._point_mass import PointMass
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock_flight._flight import heartbeat
from llm_flock_flight._flight.deadman import HeartbeatListener, land_all
from llm_flock_flight._flight.heartbeat import Heartbeat, HeartbeatSender, NoDeadman
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.takeoff import take_off
from llm_flock_flight._flight.team import FlyingTeam


def pipe_to_listener():
    out, into = os.pipe()
    return HeartbeatListener(os.fdopen(out)), os.fdopen(into, "w", buffering=1)


def say(into, **fields) -> None:
    into.write(Heartbeat(**fields).model_dump_json() + "\n")
    into.flush()


def test_a_farewell_is_a_good_end() -> None:
    listener, into = pipe_to_listener()
    say(into, aloft=(0, 1))
    say(into, farewell=True)
    assert listener.wait_for_end(5.0)
    into.close()
    listener.thread.join()


def test_a_closed_pipe_is_noticed_at_once_and_silence_in_time() -> None:
    listener, into = pipe_to_listener()
    say(into, aloft=(2,))
    into.close()
    began = time.monotonic()
    assert not listener.wait_for_end(5.0)
    assert time.monotonic() - began < 1.0 and listener.last.aloft == (2,)
    listener, into = pipe_to_listener()
    began = time.monotonic()
    assert not listener.wait_for_end(0.3)
    assert 0.2 < time.monotonic() - began < 1.0
    into.close()
    listener.thread.join()


def test_own_pause_of_the_deadman_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both stand still for 2 s, between two heartbeats: the flight goes on. One that then stays away does not."""
    listener, into = pipe_to_listener()
    say(into, aloft=(0,))
    plain, lost_s = time.monotonic, [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: plain() + lost_s[0])
    threading.Timer(0.2, lambda: lost_s.__setitem__(0, 2.0)).start()
    threading.Timer(0.4, say, (into,), {"farewell": True}).start()
    assert listener.wait_for_end(0.8)
    listener.thread.join()
    into.close()
    listener, into = pipe_to_listener()
    threading.Timer(0.2, lambda: lost_s.__setitem__(0, 4.0)).start()
    began = plain()
    assert not listener.wait_for_end(0.8)
    assert 0.4 < plain() - began < 2.0
    into.close()
    listener.thread.join()


def up(name: str, home) -> SimulatedRobot:
    """A drone that hovers, and that this process has no link to."""
    body = PointMass(home=home)
    body.arm(True)
    body.take_off(1.0, 0.01, time.monotonic() - 1.0)
    return SimulatedRobot(name, home, body=body)


def test_every_reachable_drone_is_landed() -> None:
    config = flight_config(reach_s=1.5, connect_s=0.4)
    robots = [up(f"d{k}", (x, y, 0.0)) for k, (x, y) in enumerate(STARTS)]
    assert all(robot.body.position(time.monotonic())[2] == 1.0 for robot in robots)
    robots[2]._lost = True
    said: list[str] = []
    ends = asyncio.run(land_all(config, robots, said.append))
    assert ends == {"d0": "landed", "d1": "landed", "d2": "out of reach", "d3": "landed"}
    heights = [robot.body.position(time.monotonic())[2] for robot in robots]
    assert heights == [0.0, 0.0, 1.0, 0.0]
    assert any("d0, d1, d3" in text for text in said)


@pytest.mark.usefixtures("skipped_waits")
def test_deadman_does_not_wait_for_a_silent_drone() -> None:
    """With a minute for each connection, those who answer are landed after the first call of three seconds."""
    config = flight_config(reach_s=4.0, connect_s=60.0)
    robots = [up(f"d{k}", (x, y, 0.0)) for k, (x, y) in enumerate(STARTS)]
    robots[2]._lost = True
    began = time.monotonic()
    down: list[float] = []
    plain = robots[0].land

    async def land(height_m: float, duration_s: float) -> None:
        down.append(time.monotonic() - began)
        await plain(height_m, duration_s)

    robots[0].land = land
    ends = asyncio.run(land_all(config, robots, lambda _: None))
    assert ends["d0"] == "landed" and ends["d2"] == "out of reach" and down[0] < 4.0


ROOT = Path(__file__).parents[4]
PARENT = """
import asyncio
from flights import flight_config
from llm_flock_flight._flight.heartbeat import HeartbeatSender

async def main():
    config = flight_config(deadman=True, robot="flights:one_by_one", deadman_s=1.0, reach_s=3.0)
    async with HeartbeatSender(config, lambda: {0, 2}) as heart:
        print(heart._process.pid, flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_flight_process_that_dies_or_hangs_is_taken_over(how: signal.Signals) -> None:
    env = {**os.environ, "PYTHONPATH": "tests"}
    command = [sys.executable, "-c", PARENT]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env, cwd=ROOT
    ) as parent:
        assert parent.stdout is not None and parent.stderr is not None
        try:
            assert int(parent.stdout.readline()) > 0
            parent.send_signal(how)
            assert parent.wait(10.0) == -signal.SIGKILL  # one that hangs is ended: it may hold the radio
        finally:
            parent.kill()
        said = parent.stderr.read()
    assert "the flight process is gone; calling d0, d2" in said
    killing = "has given no sign of life for 1 s; killing it, as d0, d2 cannot be called beside it"
    assert (killing in said) is (how is signal.SIGSTOP)
    assert "d0: landed" in said and "d2: landed" in said and "d1" not in said


def test_deadman_lands_flying_drones_without_a_terminal(tmp_path: Path) -> None:
    """Its output is no longer read, as when a window is closed or a pipe breaks."""
    out, into = os.pipe()
    os.close(out)
    landed = tmp_path / "landed"
    env = {**os.environ, "PYTHONPATH": "tests", "LANDED": str(landed)}
    command = [sys.executable, "-c", PARENT.replace("one_by_one", "telling")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=into, text=True, env=env, cwd=ROOT) as parent:
        os.close(into)
        assert parent.stdout is not None
        try:
            assert int(parent.stdout.readline()) > 0
        finally:
            parent.kill()
        for _ in range(400):
            if landed.exists() and landed.read_text().split() == ["d0", "d2"]:
                break
            time.sleep(0.05)
        else:
            raise AssertionError("not landed")


def test_a_deadman_that_is_gone_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    async def lose() -> None:
        config = flight_config(deadman=True, robot="flights:one_by_one", deadman_s=1.0)
        async with HeartbeatSender(config, lambda: {0}) as heart:
            assert heart._process is not None
            heart._process.kill()
            await asyncio.to_thread(heart._process.wait)
            heart.beat()
            heart.beat()

    asyncio.run(lose())
    assert caplog.text.count("the deadman process is gone") == 1


def test_nothing_takes_off_without_a_deadman(monkeypatch) -> None:
    monkeypatch.setattr(heartbeat, "READY_S", 0.01)

    async def start() -> None:
        async with HeartbeatSender(flight_config(deadman=True, robot="flights:one_by_one"), set):
            raise AssertionError("not reached")

    with pytest.raises(NoDeadman, match="the deadman process did not start"):
        asyncio.run(start())


def test_a_flight_that_fails_in_the_air_says_no_farewell(monkeypatch) -> None:
    said: list[Heartbeat] = []

    async def fail(aloft: set[int]) -> None:
        async with HeartbeatSender(flight_config(deadman=True, robot="flights:one_by_one"), lambda: aloft) as heart:
            plain = heart._send
            monkeypatch.setattr(heart, "_send", lambda beat: (said.append(beat), plain(Heartbeat(farewell=True))))
            raise RuntimeError("broken")

    for aloft, farewell in ((set(), True), ({1}, False)):
        said.clear()
        with pytest.raises(RuntimeError, match="broken"):
            asyncio.run(fail(aloft))
        assert said[-1] == Heartbeat(aloft=tuple(aloft), farewell=farewell)


def test_the_deadman_knows_of_a_take_off_before_the_drone_does(monkeypatch) -> None:
    """If anything happens between the two, the drone is called down."""
    happened: list[object] = []

    async def whole() -> None:
        config = flight_config()
        robots = [SimulatedRobot(f"d{k}", (x, y, 0.0)) for k, (x, y) in enumerate(STARTS)]
        for robot in robots:
            await robot.connect(1.0)
        team = FlyingTeam(config, robots, FlightLog(config, NullWriter()))
        team.on_take_off = lambda: happened.append(frozenset(team.aloft))

        async def refuse(height_m: float, duration_s: float) -> None:
            happened.append("take off")
            raise RobotError("d0", "refused")

        monkeypatch.setattr(robots[0], "take_off", refuse)
        with pytest.raises(RobotError, match="d0: refused"):
            await take_off(config, team, FlightLog(config, NullWriter()))

    asyncio.run(whole())
    assert happened[0] == {0} and happened.index("take off") > 0


def test_drones_of_this_process_need_no_deadman() -> None:
    assert not flight_config(deadman=True).fleet.watched
