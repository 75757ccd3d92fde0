"""The deadman: a process of its own that lands the drones when the flight process dies or hangs.

A drone that is under way when nobody talks to it any more flies on to its set-point and hovers there: no firmware
is counted on to land it. So the flight process tells this one again and again that it is alive, and who is in the air.
When that ends without a farewell, this process ends the flight process, which may hold the radio, opens its own links,
and lands everybody who is in the air.
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

from pydantic import BaseModel, ConfigDict

from llm_flock.record.writer import NullWriter
from llm_flock.robots.base import Robot, RobotError
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.fleet import build_fleet
from llm_flock.runtime.flight.landing import LANDED, LOST, STOPPED, Landing
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.preflight import connect
from llm_flock.runtime.flight.team import FlyingTeam

BEATS = 5
"""Signs of life in the time after which the deadman takes over."""

CALL_S = 0.5
"""Time between two calls of a drone that does not answer [s]."""


class Beat(BaseModel):
    """A sign of life of the flight process.

    Attributes:
        aloft: drones that are in the air, by id; of those on the floor nothing is wanted.
        farewell: the flight is over, and the deadman is not needed any more.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    aloft: tuple[int, ...] = ()
    farewell: bool = False


class Ears:
    """Listens to the flight process, in a thread: a line a beat, the end of the pipe when it has died.

    Args:
        source: where beats come from.
    """

    def __init__(self, source: TextIO) -> None:
        self.last = Beat()
        self.heard_s = time.monotonic()
        self.closed = False
        self._source = source
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()

    def _listen(self) -> None:
        with self._source:
            for line in self._source:
                self.last = Beat.model_validate_json(line)
                self.heard_s = time.monotonic()
                if self.last.farewell:
                    return
        self.closed = True


def wait_for_the_end(ears: Ears, silence_s: float, look_s: float = 0.02) -> bool:
    """Wait until the flight is over; whether it ended well."""
    while not ears.last.farewell:
        if ears.closed or time.monotonic() - ears.heard_s > silence_s:
            return ears.last.farewell
        time.sleep(look_s)
    return True


async def land_them(config: FlightConfig, robots: Sequence[Robot], say: Callable[[str], None]) -> dict[str, str]:
    """Connect to drones and land them; how each of them ended, by name.

    Args:
        config: times and distances.
        robots: those in the air.
        say: is told of each step.
    """
    until = time.monotonic() + config.safety.reach_s
    reached: list[Robot] = []
    missing = list(robots)
    ends: dict[str, str] = {}
    landings: list[asyncio.Task[dict[str, str]]] = []
    while missing and time.monotonic() < until:
        checks, _ = await connect(config, missing)
        up = [robot for robot, check in zip(missing, checks, strict=True) if check.passed]
        missing = [robot for robot in missing if robot not in up]
        reached += up
        if up:
            say(f"reached {', '.join(robot.name for robot in up)}; landing")
            landings.append(asyncio.create_task(_land(config, up)))
        if missing:
            await asyncio.sleep(CALL_S)
    for landing in landings:
        ends |= await landing
    for robot in missing:
        ends[robot.name] = LOST
    for robot in reached:
        with contextlib.suppress(TimeoutError, RobotError):
            await robot.close()
    return ends


async def _land(config: FlightConfig, robots: Sequence[Robot]) -> dict[str, str]:
    log = FlightLog(config, NullWriter())
    team = FlyingTeam(config, robots, log)
    team.aloft = set(range(len(robots)))
    landing = Landing(config, team, log)
    await landing.all_down()
    return {robots[robot].name: end for robot, end in landing.ends.items()}


def take_over(config: FlightConfig, aloft: Sequence[int], parent: int) -> dict[str, str]:
    """End the flight process if it is still there, and land everybody; how each of them ended, by name."""
    if os.getppid() == parent:  # it hangs, and may hold the radio
        os.kill(parent, signal.SIGKILL)
    fleet = build_fleet(config)
    robots = [fleet[robot] for robot in aloft]

    def say(text: str) -> None:
        sys.stderr.write(f"deadman: {text}\n")

    say(f"the flight process is gone; calling {', '.join(robot.name for robot in robots) or 'nobody'}")
    ends = asyncio.run(land_them(config, robots, say))
    for name, end in ends.items():
        say(f"{name}: {end}")
    return ends


def main() -> int:
    """Be the deadman: the configuration on the first line of standard input, then beats."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # whatever ends the flight process must not end this one
    parent = os.getppid()
    first = sys.stdin.readline()
    if not first:
        return 0
    config = FlightConfig.model_validate(json.loads(first))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    ears = Ears(sys.stdin)
    if wait_for_the_end(ears, config.fleet.deadman_s) or not ears.last.aloft:
        return 0
    ends = take_over(config, ears.last.aloft, parent)
    return 0 if all(end in (LANDED, STOPPED) for end in ends.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
