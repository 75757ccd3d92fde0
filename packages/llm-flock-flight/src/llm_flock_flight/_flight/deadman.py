"""The deadman: a separate process that lands the drones when the flight process dies or hangs.

Without commands a drone flies on to its set-point and hovers there: no firmware is relied on to land it. So the flight
process sends heartbeats that name the drones in the air. When they stop without a farewell, this process ends the
flight process, which may hold the radio, opens links to the drones in the air, and lands them.
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
from llm_flock_flight._flight.heartbeat import Heartbeat
from llm_flock_flight._flight.landing import CALL_S, CONNECT_S, LANDED, LOST, STOPPED, Landing
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.positions import feeding
from llm_flock_flight._flight.preflight import connect
from llm_flock_flight._flight.shown import ros2_bridge
from llm_flock_flight._flight.team import FlyingTeam

LOOK_S = 0.02
"""Time between two checks of the heartbeats [s]."""


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
        """Wait for the farewell (True), or until the pipe closes or is silent for too long (False)."""
        while not self.last.farewell and not self.closed and time.monotonic() - self.heard_s <= silence_s:
            time.sleep(LOOK_S)
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


def take_over(config: FlightConfig, aloft: Sequence[int], parent: int) -> dict[str, str]:
    """End the flight process if it still runs, and land the drones in the air; returns how each ended, by name."""
    if os.getppid() == parent:  # it hangs, and may hold the radio
        os.kill(parent, signal.SIGKILL)
    fleet = build_fleet(config)
    robots = [fleet[robot] for robot in aloft]

    say = _say_while_heard
    say(f"the flight process is gone; calling {', '.join(robot.name for robot in robots)}")
    ends = asyncio.run(_land_with_poses(config, robots, say))
    for name, end in ends.items():
        say(f"{name}: {end}")
    return ends


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
    _to_nowhere(1)  # it leads to the flight process, which reads nothing more
    listener = HeartbeatListener(sys.stdin)
    if listener.wait_for_end(config.fleet.deadman_s) or not listener.last.aloft:
        return 0
    ends = take_over(config, listener.last.aloft, parent)
    return 0 if all(end in (LANDED, STOPPED) for end in ends.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
