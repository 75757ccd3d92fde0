"""Preflight: every drone connected, ready, at its start and apart from the others; reports every check."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from llm_flock.robots import Equipment, Robot, RobotError, RobotState, SelfChecked
from llm_flock_flight._crazyflie.radios import MAX_SHARE, RadioPlan, exchanges_of, plan_radios
from llm_flock_flight._flight.config import ON_FLOOR_M, FlightConfig, good_place, wrong_place
from llm_flock_flight._pauses import own_pauses

SETTLE_S = 3.0  # longest time from the connections until all checks pass: batteries are read, links rated [s]
CONVERGE_S = 10.0  # the same where an estimator converges, or a landed drone still reports that it flies [s]
SLOW = ("estimator", "on the floor")  # checks for which that time is given
MEASURE_S = 1.0  # shortest time in which this computer's own pauses are measured [s]
LOOK_S = 0.05  # time between two checks [s]

CHECKS = (
    "ready",
    "controller",
    "link",
    "battery",
    "estimator",
    "on the floor",
    "start position",
    "in the arena",
    "watched",
)
"""Names of the checks of a drone. The arena is within the geofence, so a drone in the arena is as well."""

NOT_TOLD = "not checked: the drone does not tell"
RADIO = "radio"  # name of the line of a radio
PAUSES = "pauses"  # name of the check of this computer's own pauses
NAMES = ("connected", *CHECKS, "apart", "in step", PAUSES)  # names of all checks, in order


@dataclass(frozen=True, slots=True)
class Check:
    """One check of one drone, or of the `team`: the finding, and the requirement (empty where it is obvious)."""

    name: str
    who: str
    passed: bool
    found: str
    asked: str = ""

    def __str__(self) -> str:
        return f"{self.who}: {self.name}: {self.found}" + (f", {self.asked}" if self.asked else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightReport:
    """All checks of a preflight, in order, and the time until all drones were connected, or had failed."""

    checks: tuple[Check, ...]
    connect_s: float

    @property
    def passed(self) -> bool:
        return all(check.passed for check in self.checks)


async def connect(
    robots: Sequence[Robot], timeout_s: float, on_connect: Callable[[Check], None] = lambda _: None
) -> tuple[list[Check], float]:
    """Connect to all drones at once, telling `on_connect` of each; returns the checks, and the time taken [s]."""
    began = time.monotonic()

    async def one(robot: Robot) -> Check:
        try:
            await robot.connect(timeout_s)
        except RobotError as error:
            check = Check("connected", robot.name, False, error.what)
        else:
            check = Check("connected", robot.name, True, f"{time.monotonic() - began:.2f} s")
        on_connect(check)
        return check

    checks = await asyncio.gather(*map(one, robots))
    return list(checks), time.monotonic() - began


async def preflight(
    config: FlightConfig,
    robots: Sequence[Robot],
    on_connect: Callable[[Check], None] = lambda _: None,
    *,
    more: Callable[[Sequence[RobotState], float], list[Check]] = lambda states, now_s: [],
) -> PreflightReport:
    """Connect, then repeat the checks until all pass or the time for that is over; `more` returns further checks."""
    connections, seconds = await connect(robots, config.fleet.connect_s, on_connect)
    if not all(check.passed for check in connections):
        return PreflightReport(checks=tuple(connections), connect_s=seconds)
    own_pauses().restart()  # drivers have loaded their libraries, for which nothing else runs
    began = time.monotonic()
    while True:
        states, now_s = [robot.state() for robot in robots], time.monotonic()
        checks = [*look(config, [robot.name for robot in robots], states, now_s), *more(states, now_s)]
        failed = {check.name for check in checks if not check.passed}
        patience_s = CONVERGE_S if failed and failed <= {*SLOW} else SETTLE_S
        measured = not config.fleet.watched or own_pauses().measured_for_s >= MEASURE_S
        if (not failed and measured) or now_s - began > patience_s:
            checks += [*_own(robots), *_pauses(config)]
            return PreflightReport(checks=(*connections, *checks), connect_s=seconds)
        await asyncio.sleep(LOOK_S)


def _own(robots: Sequence[Robot]) -> Iterator[Check]:
    """The checks that drivers have of their own."""
    for robot in robots:
        if isinstance(robot, SelfChecked):
            for check in robot.checks():
                yield Check(check.name, robot.name, check.passed, check.found, check.asked)


def _pauses(config: FlightConfig) -> Iterator[Check]:
    """How far this computer's own pauses, since all were connected, are from those that end a flight."""
    if not config.fleet.watched:
        return
    own, most_s = own_pauses(), 0.8 * config.fleet.deadman_s  # a heartbeat may have been due just then
    longest_s, found = own.longest_s, f"at most {own.longest_s:.2f} s in {own.measured_for_s:.0f} s"
    if longest_s < most_s:
        found += f"; a flight outlives {most_s:.2g} s"
    if longest_s > most_s / 2:
        found = f"WARNING: {found}"
    asked = f"less than {most_s:.2g} s, after which the deadman takes over: end other programs, or raise deadman_s"
    yield Check(PAUSES, "team", longest_s < most_s, found, asked)


def look(config: FlightConfig, names: Sequence[str], states: Sequence[RobotState], now_s: float) -> list[Check]:
    """Every check but the connection, by drone; `now_s` is on the clock of the states."""
    found = [
        Check(title, name, *finding)
        for robot, (name, state) in enumerate(zip(names, states, strict=True))
        for title, finding in zip(CHECKS, _findings(config, robot, state, now_s), strict=True)
    ]
    return [*found, _apart(config, names, states), _in_step(config, names, states)]


def _findings(config: FlightConfig, robot: int, state: RobotState, now: float) -> Iterator[tuple[bool, str, str]]:
    """For each of `CHECKS` whether it is passed, the finding, and the requirement."""
    world, safety = config.world, config.safety
    drone = config.fleet.drones[robot] if config.fleet.drones else None
    equipment = state.equipment
    wrong = "; ".join((*(() if state.fault is None else (state.fault,)), *equipment.complaints))
    yield not wrong, wrong or "yes", "ready to fly"

    yield _controller(config, equipment)

    if state.link_lost:
        yield False, "lost", "there"
    elif state.link is None:
        yield True, NOT_TOLD, ""
    else:
        least = safety.ready_link
        yield state.link >= least, f"{state.link:.0%}", f"at least {least:.0%} of packets acknowledged"

    if state.battery_v is None:
        yield True, NOT_TOLD, ""
    else:
        own = None if drone is None else drone.ready_battery_v
        least = safety.ready_battery_v if own is None else own
        yield state.battery_v >= least, f"{state.battery_v:.2f} V", f"at least {least:.2f} V"

    age = now - state.stamp_s
    fresh = age <= safety.stall_s
    detail = f"{age:.1f} s old" if not fresh else "converged" if state.settled else "not converged"
    yield state.settled and fresh, detail, "a fresh estimate of a converged estimator"

    x, y, z = state.position
    above = z - world.floor_m
    passed = not state.flying and abs(above) <= ON_FLOOR_M
    yield passed, f"{above:+.2f} m", f"at most {ON_FLOOR_M:g} m from the floor, motors off"

    start = None if drone is None else drone.start
    if start is None:
        yield True, "not checked: no start is given", ""
    else:
        off, most = math.dist(start[:2], (x, y)), safety.start_tolerance_m
        yield off <= most, f"{off:.2f} m off", f"within {most:g} m of ({start[0]:g}, {start[1]:g}) m"

    wrong, detail = wrong_place(config, x, y), f"{x:.2f}, {y:.2f} m"
    yield wrong is None, detail if wrong is None else f"{detail}: {wrong}", good_place(config)

    yield True, f"not {', '.join(equipment.unwatched)}" if equipment.unwatched else "all", ""


def _controller(config: FlightConfig, equipment: Equipment) -> tuple[bool, str, str]:
    """Whether a drone's controller is known, and follows set-points as fast as they are."""
    name, lag_s, most = equipment.controller, equipment.lag_s, equipment.max_speed_m_s
    if name is None:
        return True, NOT_TOLD, ""
    if lag_s is None and config.safety.lag_s is None:
        return False, name, "a controller whose lag is known, or lag_s in the flight file"
    if most is not None and config.safety.max_speed_m_s > most * (1 + 1e-6):
        return False, f"{name}, for at most {most:g} m/s", f"one for max_speed_m_s, {config.safety.max_speed_m_s:g} m/s"
    return True, name if lag_s is None else f"{name}, {lag_s:.2g} s behind", ""


def _apart(config: FlightConfig, names: Sequence[str], states: Sequence[RobotState]) -> Check:
    """Distances side by side: on the floor, heights do not count. Starts of the flight file are apart by themselves."""
    least = config.safe_distance_m
    starts = [drone.start for drone in config.fleet.drones] or [None] * len(names)
    here = [state.position[:2] for state in states]
    pairs = [
        (math.dist(a, b), f"{names[j]} and {names[i]}") for i, a in enumerate(here) for j, b in enumerate(here[:i])
    ]
    # Whoever has no start of its own returns to where it stands.
    pairs += [
        (math.dist(start[:2], b), f"the start of {names[i]} and {names[j]}")
        for i, start in enumerate(starts)
        for j, b in enumerate(here)
        if start is not None and starts[j] is None
    ]
    nearest, who = min(pairs, default=(math.inf, ""))
    detail = f"{nearest:.2f} m" if pairs else "alone"
    return Check("apart", "team", nearest >= least, detail, f"at least {least:g} m between {who}")


def _in_step(config: FlightConfig, names: Sequence[str], states: Sequence[RobotState]) -> Check:
    """Drones that lag alike stay as far apart as their set-points; one that lags less gains on another."""
    named_states = zip(states, names, strict=True)
    lags = [(lag_s, name) for state, name in named_states if (lag_s := state.equipment.lag_s) is not None]
    if not lags:
        return Check("in step", "team", True, NOT_TOLD)
    (least, first), (longest, last) = min(lags), max(lags)
    gap_m, most = config.fastest_m_s * (longest - least), config.safety.tracking_m
    detail = "yes" if longest == least else f"{first} is {gap_m:.2f} m ahead of {last}, at {config.fastest_m_s:.2f} m/s"
    return Check(
        "in step", "team", gap_m <= most, detail, f"at most tracking_m, {most:g} m: the same controller and gains"
    )


def radio_plan(config: FlightConfig) -> RadioPlan:
    """The loads of a flight's radios; empty if no drone is called by radio."""
    drones = [(drone.name, drone.uri) for drone in config.fleet.drones if drone.uri is not None]
    pose_hz = config.positions.pose_rate_hz if config.positions.outside else 0.0
    return plan_radios(drones, exchanges_of(round_s=config.safety.round_s, pose_hz=pose_hz))


def radio_checks(config: FlightConfig) -> list[Check]:
    """One line for each radio. A load that is too large is only warned of: the capacity is a model's."""
    if config.fleet.robot != "crazyflie":
        return []
    return [
        Check(
            RADIO,
            f"radio {load.dongle}",
            True,
            f"WARNING: {load}" if load.share > MAX_SHARE else str(load),
            f"at most {MAX_SHARE:.0%}",
        )
        for load in radio_plan(config).loads
    ]
