"""Landing: chooses spots and an order so that no drone lands on or under another."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from llm_flock.robots import PEAK_SPEED, Position, RobotError, RobotState, Segment, TakenOver
from llm_flock_flight._flight.config import DOWN_M, FlightConfig
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.setpoints import SetPointCheck
from llm_flock_flight._flight.team import SEND_S, FlyingTeam

MARGIN_S = 3.0  # wait beyond a landing's duration for stopped motors [s]; see docs/reference/firmware.md
LANDED = "landed"  # end of a drone that landed
STOPPED = "motors stopped, not seen to land"  # it did not report its landing in time, but its motors were cut
FELL = "its motors stopped in the air"  # its supervisor stopped its motors: it lies somewhere
TOLD = "told to land, not confirmed"  # end of a drone that accepted the command to land, then fell silent
LOST = "out of reach"  # end of a drone that accepted no command any more: it hovers at its last set-point
TAKEN = "flown by a pilot, or by its own failsafe"  # it was taken over: it is neither called down nor cut
LOOK_S = 0.05  # time between two checks of a sinking drone [s]
SINKS_M, SINKS_S = 0.1, 1.5  # a drone that comes down by this much [m] in this time [s] is still landing
AGAIN_S = 0.5  # time between two calls of a drone that is out of reach [s]
CONNECT_S = 3.0  # longest wait for one connection to a drone out of reach; the deadman's first [s]
CALL_S = 0.5  # time between two calls of the deadman to drones that do not answer [s]
RINGS, SPOTS = 12, 24  # number of rings on which a free spot is searched, and of directions on each


@dataclass(frozen=True, slots=True, kw_only=True)
class Descent:
    """How one drone lands: first aside to `via` if given, a set-point above its spot, then straight down [m]."""

    robot: int
    spot: tuple[float, float]
    via: Position | None = None


def plan_landing(
    config: FlightConfig, places: Mapping[int, Position], standing: Sequence[Position]
) -> list[list[Descent]]:
    """Groups of drones that land at once, by set-points of those in the air [m] and positions of the others [m].

    The lowest drone lands first, so none sinks past another or lands under one that hovers near by. Drones side by
    side, as in every mission in the plane, land straight down all at once.
    """
    apart = config.safety.min_separation_m + 2 * config.safety.tracking_m
    order = sorted(places, key=lambda robot: (places[robot][2], robot))
    taken = [(x, y) for x, y, _ in standing]
    if _free(taken, [_flat(places[robot]) for robot in order], apart):
        return [[Descent(robot=robot, spot=_flat(places[robot])) for robot in order]]
    groups: list[list[Descent]] = []
    for k, robot in enumerate(order):
        hovering = [places[other] for other in order[k + 1 :]]
        descent = _descent(config, robot, places[robot], taken, hovering, apart)
        taken.append(descent.spot)
        groups.append([descent])
    return groups


def _flat(place: Position) -> tuple[float, float]:
    return place[0], place[1]


def _free(taken: Sequence[tuple[float, float]], spots: Sequence[tuple[float, float]], apart: float) -> bool:
    """Whether spots are apart from each other and from those taken."""
    return all(math.dist(spot, other) >= apart - 1e-3 for k, spot in enumerate(spots) for other in (*taken, *spots[:k]))


def _descent(
    config: FlightConfig,
    robot: int,
    place: Position,
    taken: Sequence[tuple[float, float]],
    hovering: Sequence[Position],
    apart: float,
) -> Descent:
    """The nearest free spot with a free path to it; straight down if there is none."""
    straight = Descent(robot=robot, spot=_flat(place))
    if _free(taken, [straight.spot], apart):
        return straight
    check = SetPointCheck(config)
    low, high = config.inner_fence
    before = [place, *hovering]
    # Drones may be nearer than allowed already; the path must not bring them nearer.
    allowed = min(apart, check.separation(before, before))
    for ring, k in product(range(1, RINGS + 1), range(SPOTS)):
        angle, reach = 2 * math.pi * k / SPOTS, ring * apart / 2
        x, y = place[0] + reach * math.cos(angle), place[1] + reach * math.sin(angle)
        via = (x, y, place[2])
        inside = low[0] <= x <= high[0] and low[1] <= y <= high[1]
        if not inside or not _free(taken, [(x, y)], apart):
            continue
        if check.separation(before, [via, *hovering]) >= allowed - 1e-3:
            return Descent(robot=robot, spot=(x, y), via=via)
    return straight


class Landing:
    """Lands drones, and calls those out of reach until they answer or the time is up; `ends` says how each ended."""

    def __init__(self, config: FlightConfig, team: FlyingTeam, log: FlightLog) -> None:
        self.ends: dict[int, str] = {}
        self._told: set[int] = set()
        self._config = config
        self._team = team
        self._log = log

    async def land_all(self) -> None:
        """Land every drone in the air."""
        team = self._team
        set_points = team.set_points()
        up = sorted(team.aloft)
        places = {robot: set_points[robot] for robot in up}
        standing = [state.position for robot, state in enumerate(team.states()) if robot not in places]
        async with asyncio.TaskGroup() as group:
            for batch in plan_landing(self._config, places, standing):
                results = await asyncio.gather(*map(self._land, batch))
                for descent, reached in zip(batch, results, strict=True):
                    if not reached:
                        group.create_task(self._call_down(descent))

    def take(self, ends: Mapping[str, str]) -> None:
        """Note the ends of drones that the deadman has landed, by name."""
        for robot, name in enumerate(self._team.names):
            if name in ends and ends[name] != LOST:
                self._log.note("landed_by_deadman", robot, end=ends[name])
                self._team.aloft.discard(robot)
                self.ends[robot] = ends[name]

    async def _land(self, descent: Descent) -> bool:
        """Land one drone; returns False if a command did not reach it."""
        safety, robot = self._config.safety, self._team.robots[descent.robot]
        self._team.airborne.discard(descent.robot)
        if descent.robot not in self._team.aloft:
            return True  # it was cut
        try:
            if descent.via is not None:
                here = self._team.set_points()[descent.robot]
                seconds = max(1.0, 1.2 * PEAK_SPEED * math.dist(here, descent.via) / safety.max_speed_m_s)
                async with asyncio.timeout(SEND_S):
                    await robot.go_to(descent.via, seconds)
                self._fly(descent.robot, here, descent.via, seconds)
                await asyncio.sleep(seconds)
            self._log.note("landing", descent.robot, spot=list(descent.spot))
            await self._sink(descent.robot)
        except TakenOver as error:
            self._taken(descent.robot, error)
        except (RobotError, TimeoutError) as error:
            self._log.note("unreachable", descent.robot, reason=str(error) or "no answer in time")
            return False
        return True

    async def _sink(self, robot: int, send_s: float = SEND_S) -> None:
        """Land straight down, and see the motors off; wait for `send_s` for the order to be taken."""
        world, safety = self._config.world, self._config.safety
        began = time.monotonic()
        body = self._team.robots[robot]
        if self._fell(body.state()):
            self._log.note("fell", robot)
            self._team.aloft.discard(robot)
            self.ends[robot] = FELL
            return
        async with asyncio.timeout(send_s):
            await body.land(world.floor_m, safety.land_s)
        self._told.add(robot)
        x, y, z = self._team.set_points()[robot]
        self._fly(robot, (x, y, z), (x, y, world.floor_m), safety.land_s)
        if await self._down(robot, began + safety.land_s + MARGIN_S):
            self._log.note("landed", robot, seconds=round(time.monotonic() - began, 3))
            self.ends[robot] = LANDED
        else:
            self._keep_from_a_cut(robot)
            # An emergency stop locks a drone until it is restarted: only for one that did not stop by itself.
            async with asyncio.timeout(2 * SEND_S):
                stopped = await body.stop_motors()
            self._log.note("not_down", robot, stopped=stopped)
            if not stopped:
                raise RobotError(body.name, "was told to land, and then to stop, and confirmed neither")
            self.ends[robot] = STOPPED
        self._team.aloft.discard(robot)

    def _keep_from_a_cut(self, robot: int) -> None:
        """Raise if a drone that did not land must not be cut: another flies it, or it is high."""
        body = self._team.robots[robot]
        state = body.state()
        if state.taken_over is not None:
            raise TakenOver(body.name, state.taken_over)
        above = state.position[2] - self._config.world.floor_m
        if above > 2.0 and not state.link_lost:  # from higher it is called down again
            raise RobotError(body.name, f"was told to land, and is still {above:.1f} m high")

    def _taken(self, robot: int, error: TakenOver) -> None:
        """Leave a drone to the pilot or failsafe that flies it."""
        self._log.note("unreachable", robot, reason=str(error))
        self._team.aloft.discard(robot)
        self.ends[robot] = TAKEN

    def _fell(self, state: RobotState) -> bool:
        """Whether a drone says that it flies no more, and cannot."""
        fresh = time.monotonic() - state.stamp_s <= self._config.safety.stall_s
        return state.fault is not None and not state.flying and fresh and not state.link_lost

    async def _down(self, robot: int, until_s: float) -> bool:
        """Wait until a drone reports its motors off; at the time limit, near the floor is enough. False if neither."""
        told_s = time.monotonic()
        floor = self._config.world.floor_m + DOWN_M
        lowest, sank_s = math.inf, told_s
        while True:
            state, now = self._team.robots[robot].state(), time.monotonic()
            if state.position[2] < lowest - SINKS_M:
                lowest, sank_s = state.position[2], now
            late = now >= max(until_s, sank_s + SINKS_S)
            # A link that was given up in a pause may have brought the order, and news of it, after all.
            fresh = state.stamp_s > told_s and now - state.stamp_s <= self._config.safety.stall_s
            if fresh and (not state.flying or (late and state.position[2] <= floor)):
                return True
            if late:
                return False
            await asyncio.sleep(LOOK_S)

    async def _call_down(self, descent: Descent) -> None:
        """Call a drone that hovers out of reach until it answers, then land it."""
        robot, safety = descent.robot, self._config.safety
        body = self._team.robots[robot]
        until, send_s = time.monotonic() + safety.reach_s, SEND_S
        while time.monotonic() < until:
            send_s = min(2.0 * send_s, 4.0)  # one that is slow to answer is given longer each time
            try:
                await body.close()
                await body.connect(min(self._config.fleet.connect_s, CONNECT_S, max(0.1, until - time.monotonic())))
                self._log.note("landing", robot, spot=list(descent.spot))
                await self._sink(robot, max(SEND_S, min(send_s, until - time.monotonic())))
            except TakenOver as error:
                self._taken(robot, error)
                return
            except (RobotError, TimeoutError):
                await asyncio.sleep(AGAIN_S)
            else:
                return
        self._log.note("given_up", robot, position=list(self._team.motions[robot].target))
        self.ends[robot] = TOLD if robot in self._told else LOST

    def _fly(self, robot: int, start: Position, end: Position, seconds: float) -> None:
        now = time.monotonic()
        self._team.motions[robot] = Segment(start=start, target=end, duration_s=seconds, began_s=now)
