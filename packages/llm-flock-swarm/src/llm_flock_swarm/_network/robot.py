"""One robot as a process: connects its agent, radio, planner and body to the network."""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import closing, suppress
from typing import cast

from llm_flock.errors import FlockError, InputError, MessageError
from llm_flock.members import OPERATOR, WORLD
from llm_flock.record import LlmEntry
from llm_flock.runtime import Stream, TeamPlanners, llm_entry, make_agent, parts_of, stream
from llm_flock.transport import Radio, Seen
from llm_flock_swarm._network.access import REPORT_S
from llm_flock_swarm._network.accusations import Accuser, Judge
from llm_flock_swarm._network.agent_loop import AgentLoop
from llm_flock_swarm._network.body_control import BodyControl
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import load_keys, open_link
from llm_flock_swarm._network.process import PeriodClock, phase_s, until_stopped
from llm_flock_swarm._network.receiving import count_refusals, receive
from llm_flock_swarm._network.wire import (
    MAX_LATENCY_S,
    Beacon,
    BeaconedMessage,
    Command,
    MissionOrder,
    WorldState,
    pack,
)
from llm_flock_swarm._signed.parts import signed_parts
from llm_flock_swarm._zenoh import ZenohLink

logger = logging.getLogger(__name__)

MAX_LATENCIES = 1024  # latencies in one report: a flood of beacons is not told beacon by beacon
CLOCK_OFF_S = 1.0  # difference of clocks above which the robot says so [s]
BEACON_DUE = 0.9  # share of a beacon period after which a message's beacon no longer replaces the next one


class RobotProcess:
    """The wiring of one robot."""

    def __init__(self, config: SwarmConfig, robot: int, link: ZenohLink) -> None:
        mission, network = config.mission, config.network
        self._config, self._robot, self._link = config, robot, link
        self._loop = asyncio.get_running_loop()
        self._phase_s = phase_s(robot, mission.n_robots, network.gossip_s)
        self.planners = TeamPlanners(config)
        self.planners.listen(lambda attempt: self._calls.append(llm_entry(attempt)))
        self._calls: list[LlmEntry] = []
        self._latencies_s: list[float] = []
        self._beacon_sent_s, self._said_clock = 0.0, False
        self._alive: set[int] = set()
        self._all_here = asyncio.Event()
        self._sees = asyncio.Event()
        self.radio = Radio(
            robot,
            mission,
            faults=config.links,
            rng=stream(config.trial.seed, Stream.LINKS, robot),
            beacon_s=network.beacon_s,
            delay_s=network.gossip_s,
            clock_error_s=network.clock_error_s,
            speed=config.speed,
        )
        self.body = BodyControl(config)
        keys = load_keys(config, robot)
        parts = parts_of(config, config.protocol.rules(), robot, apart=config.passing_distance)
        if keys is not None:
            parts = signed_parts(parts, robot, mission, keys, liars=network.liars)
        agent = make_agent(config, robot, parts, own_clock=True)
        self._accuser = None if keys is None else Accuser(Judge(keys, config))
        self.agent_loop = AgentLoop(
            config, agent, self.planners[robot], self.radio, self.body, self._broadcast, self._accuser
        )
        receive(link, "frame", WorldState, self._on_state, sender=WORLD)
        receive(link, "beacon", Beacon, self._hear)
        receive(link, "say", BeaconedMessage, lambda sender, packet: self._hear(sender, packet.beacon, packet.message))
        take_order = self.agent_loop.take_order
        receive(link, "mission", MissionOrder, lambda _, order: take_order(order), number=robot, sender=OPERATOR)
        link.watch_alive(self._config.mission.n_robots, self._on_alive)

    def _broadcast(self, message: bytes) -> None:
        beacon = self._own_beacon()
        assert beacon is not None, "a robot speaks once it knows where it is"
        self._link.publish("say", self._robot, pack(BeaconedMessage(beacon=beacon, message=message)))

    def _own_beacon(self) -> Beacon | None:
        if self.radio.position is None:
            return None
        self._beacon_sent_s = time.monotonic()
        return Beacon(stamp=time.time(), position=self.radio.position)

    def _hear(self, sender: int, beacon: Beacon, message: bytes | None = None) -> None:
        """Tell the radio where a sender is, and take what it carries from there."""
        if not 0 <= sender < self._config.mission.n_robots:
            raise MessageError("unknown_id", f"a beacon of member {sender}")
        if len(beacon.position) != self._config.mission.dim:
            raise MessageError("wrong_length", "a beacon of another dimension")
        now = time.time()
        if len(self._latencies_s) < MAX_LATENCIES:
            self._latencies_s.append(min(max(0.0, now - beacon.stamp), MAX_LATENCY_S))
        # A stamp in the future would make the beacon look younger than it is.
        seen, sealed = Seen(stamp=min(beacon.stamp, now), position=beacon.position), self._link.at_hand
        self.radio.place(sender, seen)

        def hand_over() -> None:
            with count_refusals(self._link.traffic.refused):
                self.radio.beacon(sender, seen)
                if message is not None:
                    if self._accuser is not None:
                        self._accuser.hear(sender, sealed)
                    self.agent_loop.receive(message, sender)

        self.radio.deliver(sender, hand_over, self._loop.call_later)

    def _on_state(self, _sender: int, state: WorldState) -> None:
        if len(state.bodies) == self._config.mission.n_robots:
            ahead_s = time.time() - state.stamp
            if abs(ahead_s) > CLOCK_OFF_S and not self._said_clock:
                self._said_clock = True
                self.agent_loop.note("clock", {"ahead_s": round(ahead_s, 1)})
            self.radio.frame(state.stamp, [body.position for body in state.bodies])
            self.body.update(state.bodies[self._robot])
            self._sees.set()

    def _on_alive(self, number: int, alive: bool) -> None:
        (self._alive.add if alive else self._alive.discard)(number)
        if len(self._alive - {WORLD}) >= self._config.mission.n_robots:
            self._all_here.set()

    async def live(self) -> None:
        """Wait for the own sensors, then for the other robots as long as the configuration says; then begin."""
        network = self._config.network
        await self._sees.wait()
        self._link.declare_alive(self._robot)
        with suppress(TimeoutError):
            async with asyncio.timeout(network.gather_s), asyncio.TaskGroup() as group:
                beacons = group.create_task(self._send_beacons())
                await self._all_here.wait()
                await asyncio.sleep(3 * network.beacon_s)
                beacons.cancel()
        async with asyncio.TaskGroup() as group:
            loops = self._send_beacons(), self._control(), self.agent_loop.gossip(), self._report(), self._partition()
            for task in loops:
                group.create_task(task)
            # A robot that joins late hears the others out before it begins.
            await asyncio.sleep(2 * network.gossip_s)
            group.create_task(self.agent_loop.live())

    async def _send_beacons(self) -> None:
        """Broadcast where the body is and where it will stop, unless a message has just carried that."""
        beacon_s = self._config.network.beacon_s
        clock = PeriodClock(beacon_s, self._phase_s + 0.5 * beacon_s)
        while True:
            await clock.next()
            silent_s = time.monotonic() - self._beacon_sent_s
            if silent_s > BEACON_DUE * beacon_s and (beacon := self._own_beacon()) is not None:
                self._link.publish("beacon", self._robot, pack(beacon))

    async def _control(self) -> None:
        """Command the body in every control period, or on the next news where there was nothing to command."""
        body = self.body
        while True:
            now, command = time.time(), None
            if body.is_free(now):
                command = self._command(now)
            if command is None:
                body.news.clear()
                await body.news.wait()
            else:
                self._link.publish("command", self._robot, pack(command))
                await asyncio.sleep(self._config.network.control_s)

    def _command(self, now: float) -> Command | None:
        """The next command; from the sensors alone, if what others say about themselves leads to an error.

        An error without that ends the process: a body without commands stops at the end of its last one, which is safe.
        """
        with count_refusals(self._link.traffic.refused):
            return self.body.control(now, self.radio.sightings(now), self.radio.unseen_s(now))
        self.radio.forget_beacons()
        return self.body.control(now, self.radio.sightings(now), self.radio.unseen_s(now))

    async def _report(self) -> None:
        clock = PeriodClock(REPORT_S, self._phase_s)
        while True:
            await clock.next()
            calls, ages, self._calls, self._latencies_s = self._calls, self._latencies_s, [], []
            with count_refusals(self._link.traffic.refused):  # no error about what observers are told ends a flight
                report = self.agent_loop.report(calls, ages, self._link.traffic, self.radio.contradicted)
                self._link.publish("report", self._robot, pack(report))

    async def _partition(self) -> None:
        """For tests: do not hear the other half of the ids for a while."""
        network, n = self._config.network, self._config.mission.n_robots
        if network.partition is None:
            return
        begins, ends = map(float, network.partition.split("-"))
        await asyncio.sleep(begins)
        half = n // 2
        self.radio.cut = frozenset(range(half, n) if self._robot < half else range(half))
        await asyncio.sleep(ends - begins)
        self.radio.cut = frozenset()


def _first(error: Exception) -> Exception:
    """The first exception of a group, of groups in groups."""
    if not isinstance(error, ExceptionGroup):
        return error
    return _first(cast("ExceptionGroup[Exception]", error).exceptions[0])


async def run_robot(config: SwarmConfig, robot: int) -> None:
    """Run one robot until the process is stopped, or cannot go on: its body stops where its last command ends."""
    mission = config.mission
    if not 0 <= robot < mission.n_robots:
        raise InputError("id", robot, says=f"there are robots 0 to {mission.n_robots - 1}")
    with closing(open_link(config, robot)) as link:
        process = RobotProcess(config, robot, link)
        try:
            await until_stopped(process.live())
        except ExceptionGroup as group:
            cause = _first(group)
            logger.warning("robot %d failed", robot, exc_info=cause)
            raise FlockError(f"robot {robot} cannot go on, and its body stops: {cause!r}") from group
        finally:
            await process.planners.close()
