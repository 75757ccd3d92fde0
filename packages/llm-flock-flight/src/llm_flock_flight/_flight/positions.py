"""Positions from outside in a flight: their source, their checks before take-off, and the landing without them."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Protocol, runtime_checkable

from llm_flock.errors import InputError
from llm_flock.robots import PoseSource, Robot, RobotState
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.monitors import PERIOD_S, Trouble, TroubleKind
from llm_flock_flight._flight.preflight import Check
from llm_flock_flight._flight.shown import ros2_bridge
from llm_flock_flight._flight.team import FlyingTeam
from llm_flock_flight._positions import PoseFeed, PoseGate, TakesPoses
from llm_flock_flight._positions.mocap import MocapPoses
from llm_flock_flight._positions.udp import UdpPoses

OUTSIDE = "position from outside"  # name of the preflight check of a drone's pose
SENDER = "one sender of positions"  # name of the preflight check that no second sender sends poses
LISTEN_S = 1.0  # shortest time to listen for a second sender of poses before a preflight is passed [s]
MAX_LISTEN_S = 2.0  # longest time to tell a repeated pose from a standing drone [s]
LOCALISATION = "localisation"  # name of the preflight line with a drone's own localisation


@runtime_checkable
class TellsLocalisation(Protocol):
    """A robot that knows how its own localisation is doing."""

    @property
    def localisation(self) -> str | None:
        """The state of its localisation as text; None if the robot does not know it."""
        ...


def pose_source(config: FlightConfig) -> PoseSource | None:
    """The source of a flight's poses, or ExtraMissing; None if the drones know where they are."""
    positions, names = config.positions, [drone.name for drone in config.fleet.drones]
    if positions.pose_source == "udp":
        return UdpPoses(positions.pose_host, positions.pose_port, names)
    if positions.pose_source == "mocap":
        assert positions.mocap_system is not None and positions.mocap_host is not None
        return MocapPoses(positions.mocap_system, positions.mocap_host, names)
    if positions.pose_source == "ros2":
        return ros2_bridge().poses_of(config.ros2, names)
    return None


@asynccontextmanager
async def feeding(
    config: FlightConfig, robots: Sequence[Robot], source: PoseSource | None = None
) -> AsyncGenerator[PoseFeed | None]:
    """Send poses meanwhile, from `source` or the configuration's; None without one. Robots may connect later."""
    found = pose_source(config) if source is None else source
    if found is None:
        yield None
        return
    takers: dict[str, TakesPoses] = {}
    for robot in robots:
        if not isinstance(robot, TakesPoses):
            raise InputError(
                "pose_source", config.positions.pose_source, f"a driver that takes poses; {robot.name} has none"
            )
        takers[robot.name] = robot
    gate = PoseGate(takers, config.positions, config.safety.max_speed_m_s)
    rate_hz, attitude = config.positions.pose_rate_hz, config.positions.pose_attitude
    async with PoseFeed(found, gate, takers, rate_hz, attitude=attitude) as feed:
        yield feed


def checks_of(
    config: FlightConfig, robots: Sequence[Robot], feed: PoseFeed | None
) -> Callable[[Sequence[RobotState], float], list[Check]]:
    """The preflight checks that belong to the drones' positions, as a function of the states and the time."""

    def look(states: Sequence[RobotState], now_s: float) -> list[Check]:
        found: list[Check] = []
        for robot, state in zip(robots, states, strict=True):
            if feed is not None:
                found.append(_pose_check(config, feed, robot.name, state, now_s))
            told = robot.localisation if isinstance(robot, TellsLocalisation) else None
            if told is not None:
                found.append(Check(LOCALISATION, robot.name, True, told))
        if feed is not None:
            found.append(_sender_check(config, feed, now_s))
        return found

    return look


def _pose_check(config: FlightConfig, feed: PoseFeed, name: str, state: RobotState, now_s: float) -> Check:
    most_s, most_m = config.positions.pose_lost_s, config.safety.tracking_m
    asked = f"at most {most_s:g} s old, and within {most_m:g} m of the drone's estimate"
    newest = feed.newest(name)
    if newest is None:
        dropped = ", ".join(f"{why} {count} times" for why, count in feed.refused.items())
        return Check(OUTSIDE, name, False, f"none (dropped: {dropped})" if dropped else "none", asked)
    pose, came_s = newest
    age, off = now_s - came_s, math.dist(pose.position, state.position)
    passed = age <= most_s and off <= most_m and name not in feed.gate.doubts
    return Check(OUTSIDE, name, passed, f"{age:.2f} s old, {off:.2f} m from the estimate{_doubt(feed, name)}", asked)


def _sender_check(config: FlightConfig, feed: PoseFeed, now_s: float) -> Check:
    """Whether one sender tells the positions: of two, the one that began is followed, right or wrong."""
    least_s = min(max(LISTEN_S, config.positions.pose_frozen_s + 2 * PERIOD_S), MAX_LISTEN_S)
    senders, listened_s = feed.senders(now_s), feed.listened_s(now_s)
    if len(senders) > 1:
        first, *others = senders
        found = f"{first} is followed, and {', '.join(others)} sends as well"
        return Check(SENDER, "team", False, found, "end one of them: the first that was heard is followed")
    found = senders[0] if senders else "nobody else was heard"
    if listened_s < least_s:
        return Check(SENDER, "team", False, f"listened for {listened_s:.1f} s only", f"{least_s:g} s")
    return Check(SENDER, "team", True, found)


def _doubt(feed: PoseFeed, name: str) -> str:
    """Why the newest pose of a drone was refused, if it was."""
    why = feed.gate.doubts.get(name)
    return "" if why is None else f"; what comes is refused: {why}"


def watching(
    config: FlightConfig, feed: PoseFeed, team: FlyingTeam, log: FlightLog, trip: Callable[[Trouble], None]
) -> asyncio.Task[None]:
    """A task that ends the flight when a drone gets no poses, if need be at once, and records refusals."""
    numbers = {name: robot for robot, name in enumerate(team.names)}

    def note(name: str, reason: str) -> None:
        log.note("pose_refused", numbers.get(name), reason=reason)

    feed.gate.on_refusal = note
    most_s, waiting = config.positions.pose_lost_s, set(range(len(team.names)))

    def look() -> None:
        waiting.difference_update(team.airborne)
        now = time.monotonic()
        for robot in sorted(waiting | team.airborne):
            name = team.names[robot]
            age = feed.age_s(name, now)
            if age is None or age > most_s:
                detail = f"{name}: no position from outside for {most_s:g} s{_doubt(feed, name)}"
                trip(Trouble(TroubleKind.POSE_LOST, robot, detail))

    async def watch() -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            look()

    feed.gate.flying = True
    look()
    return asyncio.create_task(watch())
