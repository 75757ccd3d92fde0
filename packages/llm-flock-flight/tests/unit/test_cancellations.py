"""A flight that ends is not flown on because a command was confirmed at the same moment.

`asyncio.wait_for` of Python 3.11 drops a cancellation that comes together with the result it waits for.
"""

from __future__ import annotations

import ast
import asyncio
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from flights import flight_config

from llm_flock.record._schema import NullWriter
from llm_flock_flight._crazyflie.threads import in_thread
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.takeoff import take_off
from llm_flock_flight._flight.team import FlyingTeam
from llm_flock_flight._mavlink.conversation import Conversation
from llm_flock_flight._mavlink.port import Port

SOURCES = Path(__file__).parents[2] / "src"

End = Callable[[], object]


async def cancelled_as_it_ends(work: Callable[[End], Coroutine[Any, Any, Any]]) -> bool:
    """Whether work that calls `end` as its wait is over, which cancels it, ends as cancelled, and at once."""
    loop, ended = asyncio.get_running_loop(), list[float]()

    def end() -> None:
        ended.append(time.monotonic())
        loop.call_soon(task.cancel)

    task: asyncio.Task[Any] = loop.create_task(work(end))
    await asyncio.wait((task,))
    return task.cancelled() and time.monotonic() - ended[0] < 0.2


@pytest.mark.usefixtures("skipped_waits")
@pytest.mark.parametrize("command", ["arm", "take_off"])
def test_no_drone_rises_after_a_flight_ended_at_a_confirmation(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def whole() -> list[bool]:
        config = flight_config(take_off_group=1)
        robots = build_fleet(config)
        for robot in robots:
            await robot.connect(1.0)
        log = FlightLog(config, NullWriter())
        team = FlyingTeam(config, robots, log)

        async def work(end: End) -> None:
            plain = getattr(robots[0], command)

            async def confirmed(*arguments: float) -> Any:
                done = await plain(*arguments)
                end()
                return done

            monkeypatch.setattr(robots[0], command, confirmed)
            await take_off(config, team, log)

        assert await cancelled_as_it_ends(work)
        return [robot.state().flying for robot in robots[1:]]

    assert not any(asyncio.run(whole()))


def test_a_call_in_a_thread_that_ends_with_the_flight() -> None:
    async def work(end: End) -> None:
        loop = asyncio.get_running_loop()

        def start(job: Callable[[], None]) -> None:
            loop.call_soon(lambda: (job(), end()))

        await in_thread(lambda: None, 5.0, start)
        await asyncio.sleep(0.3)

    assert asyncio.run(cancelled_as_it_ends(work))


def test_an_answer_that_comes_with_the_end_of_the_flight() -> None:
    async def work(end: End) -> None:
        answers: asyncio.Queue[int] = asyncio.Queue()
        asyncio.get_running_loop().call_soon(lambda: (answers.put_nowait(0), end()))
        talk = Conversation("v", Port("udp://127.0.0.1:14540"), 1)
        await talk._answer(answers, 5.0)
        await asyncio.sleep(0.3)

    assert asyncio.run(cancelled_as_it_ends(work))


def test_drivers_and_flights_do_not_wait_with_asyncio_wait_for() -> None:
    files = list(SOURCES.rglob("*.py"))
    assert len(files) > 50
    lines = [
        f"{path.name}:{node.lineno}"
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "asyncio.wait_for"
    ]
    assert not lines, "use asyncio.timeout"
