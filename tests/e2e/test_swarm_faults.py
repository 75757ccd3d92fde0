"""Faults of real processes on 127.0.0.1: the others go on, and form."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

from swarms import fly, formed, living, swarm_config

from llm_flock.record._reader import read_record
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.swarm import Swarm, SwarmResult, launch_swarm, run_swarm

SAFE = 3.0 - 1e-6


def check(result: SwarmResult, robots: int) -> None:
    assert result.formed and result.n_robots == robots, result
    assert result.min_separation >= SAFE, result


def test_five_processes_form_and_leave_a_record(tmp_path: Path) -> None:
    result = fly(swarm_config(5, out=str(tmp_path)))
    check(result, 5)
    assert result.latency_p99_s is not None and result.bytes_per_robot_s < 20_000
    found = read_record(tmp_path / "run.mcap")
    assert len(found.states) > 5 and found.states[-1].phases.count("dead") == 0
    assert {event.kind for event in found.events} >= {"proposed", "adopted", "claimed"}
    assert found.llm and found.result is not None


def test_a_killed_recorder_is_not_missed(tmp_path: Path) -> None:
    async def strike(swarm: Swarm) -> None:
        await asyncio.sleep(3.0)
        os.kill(swarm.pids["recorder"], signal.SIGKILL)

    check(fly(swarm_config(5, out=str(tmp_path)), strike), 5)
    found = read_record(tmp_path / "run.mcap")
    assert found.states and found.result is None


def broken(*_: object) -> None:
    raise ZeroDivisionError


def test_a_broken_display_and_sink_are_not_missed() -> None:
    """Both belong to the launcher, which ends every robot when it ends."""

    class Sink:
        def write(self, entry: object) -> None:
            raise ZeroDivisionError

    result = asyncio.run(run_swarm(swarm_config(3), on_row=broken, sink=Sink()))
    check(result, 3)
    assert sorted(result.gave_up) == ["display", "sink"]


def test_robots_fly_on_without_the_launchers_observer() -> None:
    pids: dict[str, int] = {}

    async def fly() -> SwarmResult:
        async with launch_swarm(swarm_config(3, max_s=8.0)) as swarm:
            while swarm.observer.began_s is None:  # noqa: ASYNC110 - there is no event to wait for
                await asyncio.sleep(0.05)
            swarm.observer.check = broken
            stopped = await swarm.run()
            pids.update(swarm.pids)
            assert living(set(pids.values())) == set(pids.values())
            return swarm.result(stopped)

    result = asyncio.run(fly())
    assert (result.stopped, result.formed, list(result.gave_up)) == ("time", None, ["observer"])
    assert not living(set(pids.values()))


def test_stopped_robot_resumes_at_its_position() -> None:
    async def strike(swarm: Swarm) -> None:
        await asyncio.sleep(2.0)
        os.kill(swarm.pids["robot-1"], signal.SIGSTOP)
        await asyncio.sleep(3.0)
        os.kill(swarm.pids["robot-1"], signal.SIGCONT)
        await asyncio.sleep(2.5)

    check(fly(swarm_config(5), strike, until=lambda o: formed(o) and len(o.robots) == 5), 5)


def test_loss_and_jitter() -> None:
    check(fly(swarm_config(5, loss=0.3, delay=2)), 5)


def test_a_late_robot_finds_its_place() -> None:
    async def come(swarm: Swarm) -> None:
        await asyncio.sleep(4.0)
        await swarm.start_robot(4)
        await asyncio.sleep(1.0)

    config = swarm_config(5, gather_s=1.0)
    check(fly(config, come, absent=frozenset({4}), until=lambda o: formed(o) and len(o.robots) == 5), 5)


def test_a_killed_robot_is_done_without_and_starts_again() -> None:
    async def strike(swarm: Swarm) -> None:
        await asyncio.sleep(2.0)
        os.kill(swarm.pids["robot-2"], signal.SIGKILL)
        await asyncio.sleep(0.5)
        while not (formed(swarm.observer) and len(swarm.observer.robots) == 4):  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0.1)
        await swarm.start_robot(2)
        await asyncio.sleep(2.0)

    check(fly(swarm_config(5), strike, until=lambda o: formed(o) and len(o.robots) == 5), 5)


def test_a_divided_team_agrees_again() -> None:
    def healed(observer: Observer) -> bool:
        return formed(observer) and observer.in_order and observer.heard_s[0] - (observer.began_s or 0.0) > 13.0

    check(fly(swarm_config(6, partition="1-11"), until=healed), 6)


def test_one_robots_model_is_down() -> None:
    models = "0-2=simulated:brisk,3=openai-compatible:down,4=simulated:brisk"
    config = swarm_config(
        5, model=models, base_url="http://127.0.0.1:9/v1", fallback="geometry", max_tries=1, timeout_s=1.0
    )
    result = fly(config)
    check(result, 5)
    assert result.calls_failed > 0
