"""Watches a running swarm from outside, records it, and gives it missions: the network side of an observer."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from llm_flock.members import OPERATOR, WATCHER, WORLD
from llm_flock.message import MissionStamp, OperatorClock
from llm_flock.mission import Mission
from llm_flock.record import Guarded, NullWriter, RecordSink, RecordWriter, SummaryMessage, Tee
from llm_flock.runtime import TrialProgress, finite, run_info
from llm_flock_swarm._network.accusations import Judge
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import load_keys, open_link
from llm_flock_swarm._network.mission_orders import mission_order, mission_verifier
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.process import until_stopped
from llm_flock_swarm._network.receiving import receive
from llm_flock_swarm._network.wire import RobotReport, WorldState, pack

CHECK_S = 0.1  # time between two checks whether the team has formed [s]
MEET_S = 5.0  # longest search of an operator for a robot that takes a mission [s]
HEAR_S = 0.5  # time for which an operator listens to the robots' reports before it gives an order [s]: a few of each
TELL_S = 20.0  # longest wait for the mission of a swarm: robots spell it out now and then [s]
SEND_S = 0.3  # time for a message to leave before its session is closed [s]
FREE_PORT = "tcp/127.0.0.1:0"  # where processes listen that are no part of the swarm


def observer_of(
    config: SwarmConfig, member: int, sink: RecordSink, on_row: Callable[[TrialProgress], None] | None = None
) -> Observer:
    """An observer that checks signatures with the keys of this member, if the swarm uses any."""
    keys = load_keys(config, member)
    judge = None if keys is None else Judge(keys, config)
    return Observer(config, sink, on_row, signed=mission_verifier(config, member), judge=judge)


@contextmanager
def recording(config: SwarmConfig, record: Path | None, sink: RecordSink | None = None) -> Generator[RecordSink]:
    """A writer of a swarm's record to a file, and to a sink, begun with the entry of the run."""
    with nullcontext(NullWriter()) if record is None else RecordWriter(record) as file:
        writer = file if sink is None else Tee(file, Guarded("sink", sink.write, {}))
        writer.write(run_info(config, simulated=config.simulated, unrepeatable=config.unrepeatable))
        yield writer


@contextmanager
def observing(
    config: SwarmConfig, sink: RecordSink, on_row: Callable[[TrialProgress], None] | None = None
) -> Generator[Observer]:
    """An observer that is connected to a swarm; call in a running event loop."""
    observer = observer_of(config, WATCHER, sink, on_row)
    with closing(open_link(config, WATCHER, FREE_PORT)) as link:
        receive(link, "frame", WorldState, lambda _, state: observer.world(state), sender=WORLD)
        receive(link, "report", RobotReport, observer.report)
        link.watch_alive(config.mission.n_robots, observer.comes_or_goes)
        yield observer


async def look(observer: Observer, *, alone: bool = True) -> None:
    """Let an observer check the team until cancelled. If `alone` here, it raises its error or its sink's."""
    check = observer.check if alone else Guarded("observer", observer.check, observer.ended)
    while True:
        check()
        if alone and "sink" in observer.ended:
            raise observer.ended["sink"]
        await asyncio.sleep(CHECK_S)


async def run_watch(
    config: SwarmConfig,
    record: Path | None,
    on_row: Callable[[TrialProgress], None] | None = None,
    sink: RecordSink | None = None,
    show: Callable[[SwarmConfig, Observer], None] | None = None,
    told: Path | None = None,
) -> None:
    """Watch, and with a path write a record, until the process is stopped; `show` is called with the observer first.

    The record ends with the result in the file `told`, if it is there by then, else with what was seen here.
    """
    with ExitStack() as stack:
        writer = stack.enter_context(recording(config, record, sink))
        observer = stack.enter_context(observing(config, writer, on_row))
        if show is not None:
            show(config, observer)
        await until_stopped(look(observer))
        result = {
            "stopped": "interrupted",
            "formed": observer.formed_s is not None,
            "mission_s": observer.mission_s,
            "min_separation": finite(observer.min_separation),
            "model_calls": observer.said.calls,
            "tokens": observer.said.tokens,
        }
        writer.write(SummaryMessage(result=_result(told) or result))


def _result(told: Path | None) -> dict[str, Any] | None:
    return json.loads(told.read_bytes()) if told is not None and told.exists() else None


async def present_mission(config: SwarmConfig) -> Mission | None:
    """The mission that a running swarm flies; None if no robot tells it within `TELL_S`."""
    with observing(config, NullWriter()) as observer:
        for _ in range(round(TELL_S / CHECK_S)):
            await asyncio.sleep(CHECK_S)
            told = [tuple(report.mission) for report in observer.reports.values()]
            if told and max(told)[1] == observer.mission.digest:
                return observer.mission
    return None


async def give_mission(config: SwarmConfig, fields: dict[str, object], robot: int | None) -> list[int]:
    """Give another mission to one robot, which passes it on; returns the robots that got it, none if none answers.

    If `robot` is None and the team has keys, one robot more than may lie gets it. The order is later than those that
    robots report within `HEAR_S`, even if the clock of this machine is behind.
    """
    clock = OperatorClock(lambda: time.time_ns() // 1_000_000)
    mission_order(config, dict(fields), clock.next())  # rejects invalid fields before the search for robots
    found: list[int] = []
    answered = asyncio.Event()
    most = 1 if robot is not None or config.network.keys is None else config.network.liars + 1

    def on_alive(number: int, alive: bool) -> None:
        if alive and number >= 0 and robot in (None, number) and number not in found:
            found.append(number)
            answered.set()

    with closing(open_link(config, OPERATOR, FREE_PORT)) as link:
        link.watch_alive(config.mission.n_robots, on_alive)
        signed = mission_verifier(config, OPERATOR)

        def witness(_robot: int, report: RobotReport) -> None:
            if signed is None or signed(MissionStamp(*report.mission), report.order):
                clock.witness(report.mission[0], own=signed is not None)

        receive(link, "report", RobotReport, witness)
        try:
            await asyncio.wait_for(answered.wait(), MEET_S)
        except TimeoutError:
            return []
        await asyncio.sleep(HEAR_S)
        takers, order = found[:most], pack(mission_order(config, dict(fields), clock.next()))
        for taker in takers:
            link.publish("mission", taker, order)
        await asyncio.sleep(SEND_S)
        return takers
