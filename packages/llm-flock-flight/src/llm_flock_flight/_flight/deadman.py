"""The deadman: a separate process that lands the drones when the flight process dies or hangs.

Without commands a drone flies on to its set-point and hovers there: no firmware is relied on to land it. So the flight
process sends heartbeats that name the drones in the air. When they stop without a farewell, this process opens links to
the drones in the air and lands them. It first ends a flight process that lives and holds what only one process can use,
such as a radio. Any other it tells what it does, and leaves alive.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import TextIO

from llm_flock.errors import InputError
from llm_flock.record import NullWriter
from llm_flock.robots import Robot, RobotError
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.heartbeat import Heartbeat, TakeOver
from llm_flock_flight._flight.landing import CALL_S, CONNECT_S, LANDED, LOST, STOPPED, Landing
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.positions import feeding
from llm_flock_flight._flight.preflight import connect
from llm_flock_flight._flight.shown import ros2_bridge
from llm_flock_flight._flight.team import FlyingTeam
from llm_flock_flight._pauses import PAUSE_S

LOOK_S = 0.02  # time between two checks of the heartbeats [s]


class HeartbeatListener:
    """Reads heartbeats from a pipe in a thread, one a line. The pipe closes when the flight process dies."""

    def __init__(self, source: TextIO) -> None:
        self.last = Heartbeat()
        self.heard_s = time.monotonic()
        self.closed = False
        self._source = source
        self.thread = threading.Thread(target=self._listen, daemon=True)
        self.thread.start()

    def _listen(self) -> None:
        with self._source:
            for line in self._source:
                self.last = Heartbeat.model_validate_json(line)
                self.heard_s = time.monotonic()
                if self.last.farewell:
                    return
        self.closed = True

    def wait_for_end(self, silence_s: float) -> bool:
        """Wait for the farewell (True), or until the pipe closes or is silent for too long (False).

        A long time between two looks was a pause of this process, and probably of the flight's: it is no silence.
        """
        heard_s, silent_s, looked_s = self.heard_s, 0.0, time.monotonic()
        while not self.last.farewell and not self.closed and silent_s <= silence_s:
            time.sleep(LOOK_S)
            now = time.monotonic()
            silent_s = silent_s + min(now - looked_s, PAUSE_S) if self.heard_s == heard_s else 0.0
            heard_s, looked_s = self.heard_s, now
        return self.last.farewell


async def land_all(config: FlightConfig, robots: Sequence[Robot], say: Callable[[str], None]) -> dict[str, str]:
    """Connect to drones in the air and land them, telling `say` each step; returns how each ended, by name."""
    until = time.monotonic() + config.safety.reach_s
    missing, longest_s = list(robots), CONNECT_S
    landings: list[asyncio.Task[dict[str, str]]] = []
    while missing and time.monotonic() < until:
        # Nobody who was reached waits for long to be landed, because another one does not answer.
        checks, _ = await connect(missing, min(config.fleet.connect_s, longest_s))
        longest_s *= 2.0
        up = [robot for robot, check in zip(missing, checks, strict=True) if check.passed]
        missing = [robot for robot in missing if robot not in up]
        if up:
            say(f"reached {', '.join(robot.name for robot in up)}; landing")
            landings.append(asyncio.create_task(_land(config, up)))
        if missing:
            await asyncio.sleep(CALL_S)
    ends: dict[str, str] = {}
    for landing in landings:
        ends |= await landing
    for robot in robots:
        if robot in missing:
            ends[robot.name] = LOST
            continue
        with contextlib.suppress(TimeoutError, RobotError):
            await robot.close()
    return ends


async def _land(config: FlightConfig, robots: Sequence[Robot]) -> dict[str, str]:
    log = FlightLog(config, NullWriter())
    team = FlyingTeam(config, robots, log)
    team.aloft = set(range(len(robots)))
    landing = Landing(config, team, log)
    await landing.land_all()
    return {robots[robot].name: end for robot, end in landing.ends.items()}


def take_over(
    config: FlightConfig, aloft: Sequence[int], parent: int, why: str, tell: Callable[[TakeOver], None]
) -> dict[str, str]:
    """Land the drones in the air; returns how each ended, by name. What is done, and `why`, is written before.

    A flight process that lives is told, and killed only if a drone cannot be called beside it.
    """
    say, fleet = _say_while_heard, build_fleet(config)
    robots, ends = [fleet[robot] for robot in aloft], dict[str, str]()
    if os.getppid() == parent and config.fleet.shares_links and not config.positions.outside:
        say(f"the flight process {parent} {why}; leaving it alive, and calling {_names(robots)} beside it")
        tell(TakeOver())
        ends = asyncio.run(_land_with_poses(config, robots, say))
        robots = [robot for robot in robots if ends[robot.name] == LOST]
    if robots and os.getppid() == parent:
        say(f"the flight process {parent} {why}; killing it, as {_names(robots)} cannot be called beside it")
        os.kill(parent, signal.SIGKILL)
    if robots:
        say(f"the flight process is gone; calling {_names(robots)}")
        ends |= asyncio.run(_land_with_poses(config, robots, say))
    for name, end in ends.items():
        say(f"{name}: {end}")
    tell(TakeOver(ends=ends))
    return ends


def _names(robots: Sequence[Robot]) -> str:
    return ", ".join(robot.name for robot in robots)


def _say_while_heard(text: str) -> None:
    """Write to the terminal. It may have closed with the flight process; from then on nothing is written."""
    try:
        sys.stderr.write(f"deadman: {text}\n")
        sys.stderr.flush()
    except (OSError, ValueError):
        _to_nowhere(2)


def _to_nowhere(handle: int) -> None:
    """Let everything that is written there vanish: by libraries, too, whose threads a fault would end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, handle)
    os.close(nowhere)


async def _land_with_poses(config: FlightConfig, robots: Sequence[Robot], say: Callable[[str], None]) -> dict[str, str]:
    """Land drones, with positions from outside if they need them and the source can be opened here."""
    async with contextlib.AsyncExitStack() as stack:
        try:
            feed = await stack.enter_async_context(feeding(config, robots))
            if feed is not None:
                feed.gate.flying = True
        except InputError as error:
            say(f"no positions from outside: {error}")
        return await land_all(config, robots, say)


def main() -> int:
    """Run the deadman: reads the configuration from the first line of standard input, then heartbeats."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # what ends the flight process must not end this one
    parent = os.getppid()
    first = sys.stdin.readline()
    if not first:
        return 0
    config = FlightConfig.model_validate(json.loads(first))
    if config.positions.pose_source == "ros2":
        ros2_bridge().prepare()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    flight = os.dup(1)
    _to_nowhere(1)  # what a library prints must not reach the flight process

    def tell(word: TakeOver) -> None:
        with contextlib.suppress(OSError):
            os.write(flight, word.model_dump_json().encode() + b"\n")

    listener = HeartbeatListener(sys.stdin)
    if listener.wait_for_end(config.fleet.deadman_s) or not listener.last.aloft:
        return 0
    why = "has failed" if listener.closed else f"has given no sign of life for {config.fleet.deadman_s:g} s"
    ends = take_over(config, listener.last.aloft, parent, why, tell)
    return 0 if all(end in (LANDED, STOPPED) for end in ends.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
