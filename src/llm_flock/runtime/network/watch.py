"""Watches a running swarm from outside, and records it: the network ends of an observer."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from llm_flock.errors import MessageError
from llm_flock.record.schema import SummaryMessage
from llm_flock.record.writer import NullWriter, RecordSink, RecordWriter
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.joining import open_link, ordered
from llm_flock.runtime.network.observer import Observer
from llm_flock.runtime.network.process import until_stopped
from llm_flock.runtime.network.wire import Frame, Report, pack, unpack
from llm_flock.runtime.trial import TrialProgress
from llm_flock.transport.seal import OPERATOR, WATCHER, WORLD
from llm_flock.transport.zenoh import Link

CHECK_S = 0.1
"""Time between two looks at whether the team has formed [s]."""

MEET_S = 5.0
"""So long an operator looks for the robot that is to take a mission [s]."""


def visit(config: SwarmConfig, member: int = WATCHER) -> Link:
    """A link of somebody who is no part of the swarm."""
    return open_link(config, member, listen="tcp/127.0.0.1:0")


def attend(link: Link, observer: Observer) -> None:
    """Let an observer have what comes in."""

    def frame(sender: int, payload: bytes) -> None:
        if sender == WORLD:
            try:
                observer.frame(unpack(Frame, payload))
            except MessageError as error:
                link.traffic.refused[error.reason] += 1

    def report(sender: int, payload: bytes) -> None:
        try:
            observer.report(sender, unpack(Report, payload))
        except MessageError as error:
            link.traffic.refused[error.reason] += 1

    link.listen("frame", None, frame)
    link.listen("report", None, report)
    link.watch_alive(observer.comes_or_goes)


@contextmanager
def observing(
    config: SwarmConfig, sink: RecordSink, on_row: Callable[[TrialProgress], None] | None = None
) -> Generator[Observer]:
    """An observer that is connected to a swarm; needs a running event loop."""
    observer = Observer(config, sink, on_row)
    link = visit(config)
    try:
        attend(link, observer)
        yield observer
    finally:
        link.close()


async def look(observer: Observer) -> None:
    """Let an observer look again and again, until this is cancelled."""
    while True:
        observer.check(time.time())
        await asyncio.sleep(CHECK_S)


async def run_watch(
    config: SwarmConfig,
    record: Path | None,
    on_row: Callable[[TrialProgress], None] | None = None,
    parent: int | None = None,
) -> None:
    """Watch until the process is told to end.

    Args:
        config: the swarm.
        record: file to write, None for none.
        on_row: told of every row of the record.
        parent: process to end with.

    Raises:
        InputError: there is a record already.
    """
    with ExitStack() as stack:
        writer = stack.enter_context(NullWriter() if record is None else RecordWriter(record))
        writer.write(run_info(config, simulated=config.simulated))
        observer = stack.enter_context(observing(config, writer, on_row))
        await until_stopped(look(observer), parent=parent)
        figures = observer.figures
        result = {
            "formed": observer.formed_s is not None,
            "mission_s": None
            if observer.formed_s is None or observer.began_s is None
            else observer.formed_s - observer.began_s,
            "min_separation": figures.min_separation,
            "model_calls": figures.calls,
            "tokens": figures.tokens,
        }
        writer.write(SummaryMessage(result=result))


async def give_mission(config: SwarmConfig, fields: dict[str, object], robot: int | None) -> int | None:
    """Give another mission to one robot: to the given one, or to any that is there. Who took it, None for nobody."""
    order = ordered(config, dict(fields))
    link = visit(config, OPERATOR)
    found: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def comes(number: int, there: bool) -> None:
        if there and number >= 0 and robot in (None, number) and not found.done():
            found.set_result(number)

    try:
        link.watch_alive(comes)
        try:
            taker = await asyncio.wait_for(found, MEET_S)
        except TimeoutError:
            return None
        link.publish("mission", taker, pack(order))
        await asyncio.sleep(0.3)  # what was just said has to leave before the session is closed
        return taker
    finally:
        link.close()
