"""Conformance tests for drivers: a short flight of one robot that checks every promise of `Robot`."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable

from llm_flock.robots._base import Position, Robot, RobotError, RobotState

CONNECT_TIMEOUT_S = 30.0
"""Time in which a robot must connect, and settle, also over a link that loses packets and on a busy machine [s]."""

PATIENCE_S = 3.0
"""Longest delay between a command and the estimate [s]."""


async def wait_until(condition: Callable[[], bool], timeout_s: float, what: str) -> None:
    """Wait until the condition holds; AssertionError with `what` after `timeout_s`."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"not within {timeout_s:g} s: {what}"
        await asyncio.sleep(0.02)


def distance(a: Position, b: Position) -> float:
    return math.dist(a, b)


async def check_robot(
    robot: Robot,
    *,
    height_m: float = 0.5,
    step_m: float = 0.3,
    tolerance_m: float = 0.1,
    beyond: Position | None = (1000.0, 0.0, 0.5),
    connect_timeout_s: float = CONNECT_TIMEOUT_S,
    patience_s: float = PATIENCE_S,
) -> None:
    """Check that a driver keeps the contract of `Robot`, in one flight of about ten seconds.

    Unconnected robots raise; states are fresh and advance; arming is confirmed; what is commanded is what is flown;
    a target outside the limits is cut on its own line; hold stops on the way; a landed robot is not flying; the
    link stays closed after `close`, twice.

    Args:
        robot: not connected yet, on free ground, with a working link.
        height_m: flight height above the start.
        step_m: length of the segments; needs as much free space towards increasing x and y.
        tolerance_m: largest distance of the estimate from the target.
        beyond: a target outside the driver's limits; None skips that check.
        connect_timeout_s: given to `connect`.
        patience_s: largest delay beyond the duration of a command.
    """
    assert isinstance(robot.name, str) and robot.name, "a robot has a name"
    await _check_unconnected(robot)
    await robot.connect(connect_timeout_s)
    try:
        await _check_flight(robot, height_m, step_m, tolerance_m, beyond, patience_s)
    finally:
        await robot.close()
    await robot.close()
    await _check_refusal(robot, "after close")


async def check_emergency_stop(robot: Robot, *, height_m: float = 0.4, patience_s: float = PATIENCE_S) -> None:
    """Check that an emergency stop in the air is confirmed and final. The robot FALLS: only in a net."""
    await robot.connect(CONNECT_TIMEOUT_S)
    try:
        await wait_until(lambda: robot.state().settled, CONNECT_TIMEOUT_S, "the estimator settles")
        await robot.arm()
        start = robot.state().position
        await robot.take_off(start[2] + height_m, 1.0)
        await asyncio.sleep(1.0)
        assert await robot.stop_motors() is True, "an emergency stop on a working link is confirmed"
        await wait_until(lambda: not robot.state().flying, patience_s, "a stopped robot is not flying")
        assert not robot.state().armed, "a stopped robot is not armed"
        try:
            await robot.take_off(start[2] + height_m, 1.0)
        except RobotError:
            pass
        else:
            raise AssertionError("a robot took off after an emergency stop")
    finally:
        await robot.close()


async def _check_unconnected(robot: Robot) -> None:
    named: str | None = None
    try:
        robot.state()
    except RobotError as error:
        named = error.name
    assert named is not None, "state() of a robot that was never connected has to raise RobotError"
    assert named == robot.name, "an error names its robot"
    await _check_refusal(robot, "before connect")
    assert await robot.stop_motors() is False, "an emergency stop without a link is not confirmed"
    await robot.close()


async def _check_refusal(robot: Robot, when: str) -> None:
    try:
        await robot.go_to((0.0, 0.0, 1.0), 1.0)
    except RobotError:
        return
    raise AssertionError(f"go_to {when} has to raise RobotError")


async def _check_flight(
    robot: Robot, height_m: float, step_m: float, tolerance_m: float, beyond: Position | None, patience_s: float
) -> None:
    await wait_until(lambda: robot.state().settled, CONNECT_TIMEOUT_S, "the estimator settles")
    first = robot.state()
    _check_state(first)
    await wait_until(lambda: robot.state().stamp_s > first.stamp_s, 1.0, "states advance")
    assert not first.flying, "a robot on the ground is not flying"
    await _check_refusal(robot, "on the ground")
    await robot.arm()
    await wait_until(lambda: robot.state().armed, patience_s, "an armed robot says so")

    x, y, z = first.position
    sent = await robot.take_off(z + height_m, 1.5)
    assert distance(sent.target, (x, y, z + height_m)) <= tolerance_m, (
        "a take-off goes straight up to where it was sent"
    )
    assert sent.duration_s == 1.5, "a duration is never changed"
    await _arrives(robot, sent.target, 1.5 + patience_s, tolerance_m)
    assert robot.state().flying, "a robot in the air is flying"

    target = (x + step_m, y, z + height_m)
    sent = await robot.go_to(target, 1.0)
    assert sent.target == target and sent.duration_s == 1.0, "an allowed way-point is sent as it is"
    await _arrives(robot, target, 1.0 + patience_s, tolerance_m)

    await _check_hold(robot, (x + step_m, y + step_m, z + height_m), step_m, patience_s)
    if beyond is not None:
        await _check_cut(robot, beyond)
    await robot.land(z, 2.0)
    await wait_until(lambda: not robot.state().flying, 2.0 + patience_s, "a landed robot is not flying")
    ends = robot.state().position[2]
    assert abs(ends - z) <= max(tolerance_m, 0.1), f"a landed robot is on the ground: at {z:.3g} m, not {ends:.3g} m"


def _check_state(state: RobotState) -> None:
    assert len(state.position) == 3, "positions have three coordinates"
    assert abs(time.monotonic() - state.stamp_s) < 1.0, "stamps are of time.monotonic"
    assert not state.link_lost, "the link is not lost"
    assert state.link is None or 0.0 <= state.link <= 1.0, "link is a share"
    assert state.battery_v is None or 0.0 < state.battery_v < 100.0, "battery is in volts"


async def _arrives(robot: Robot, target: Position, timeout_s: float, tolerance_m: float) -> None:
    near = f"{robot.name} arrives at {target}"
    await wait_until(lambda: distance(robot.state().position, target) <= tolerance_m, timeout_s, near)


async def _check_hold(robot: Robot, target: Position, step_m: float, patience_s: float) -> None:
    """Hold half way: the robot has to come to rest before the target."""
    await robot.go_to(target, 3.0)
    await asyncio.sleep(1.2)
    await robot.hold()
    await asyncio.sleep(1.5 + 0.2 * patience_s)
    rest = robot.state().position
    await asyncio.sleep(0.5)
    assert distance(robot.state().position, rest) < 0.2 * step_m, "a robot that holds does not move"
    assert distance(rest, target) > 0.05 * step_m, "a robot that holds does not fly on to its target"
    assert robot.state().flying, "a robot that holds stays in the air"


async def _check_cut(robot: Robot, beyond: Position) -> None:
    """A target beyond the limits is brought nearer on the same line, in the same duration."""
    here = robot.state().position
    sent = await robot.go_to(beyond, 3.0)
    assert sent.target != beyond, "a target beyond the limits has to be brought nearer"
    assert sent.duration_s == 3.0, "a duration is never changed"
    along = distance(here, sent.target) + distance(sent.target, beyond)
    assert along <= distance(here, beyond) + 0.1, "a target is brought nearer along the segment, not aside"
    await robot.hold()
    await asyncio.sleep(1.2)
