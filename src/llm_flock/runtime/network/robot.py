"""One robot as a process of its own: its mind, its radio, its model and the wires to its body."""

from __future__ import annotations

import asyncio
import time
from typing import Any

from llm_flock.errors import InputError, MessageError
from llm_flock.llm.port import Attempt
from llm_flock.protocol.agent import Agent
from llm_flock.runtime.journal import llm_entry
from llm_flock.runtime.network.body import Pilotage
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.joining import load_keys, open_link
from llm_flock.runtime.network.mind import Mind
from llm_flock.runtime.network.pace import Beat, phase_s
from llm_flock.runtime.network.process import until_stopped
from llm_flock.runtime.network.wire import Beacon, Frame, Order, Report, Saying, pack, unpack
from llm_flock.runtime.rules import assignment_rule, consensus_rule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.team import Thinkers
from llm_flock.transport.radio import Radio, Seen
from llm_flock.transport.seal import OPERATOR, WORLD
from llm_flock.transport.zenoh import Link

REPORT_S = 0.2
"""Time between two reports to observers [s]."""

ALREADY_TOLD = 0.9
"""No beacon is due before so many of its periods after a message that has brought one."""


class Robot:
    """The wiring of one robot.

    Args:
        config: the swarm.
        robot: own id.
        link: the network.
    """

    def __init__(self, config: SwarmConfig, robot: int, link: Link) -> None:
        mission, protocol, network = config.mission, config.protocol, config.network
        self._config, self._robot, self._link = config, robot, link
        self._loop = asyncio.get_running_loop()
        self.thinkers = Thinkers(config)
        self.thinkers.listen(self._called)
        self._calls: list[dict[str, Any]] = []
        self._latencies_s: list[float] = []
        self._shone = 0.0
        self._known: set[str] = {mission.digest}
        self._alive: set[int] = set()
        self._all_here = asyncio.Event()
        self._sees = asyncio.Event()
        agent = Agent(
            robot,
            mission,
            consensus_rule(protocol.consensus or ""),
            assignment_rule(protocol.assignment or ""),
            shield_on=bool(protocol.shield),
            verify=bool(protocol.verify),
            on_event=config.model.decide == "on-event",
            time_out=protocol.time_out,
            gaps=protocol.gaps,
            own_clock=True,
            authenticator=load_keys(config, robot),
        )
        self.radio = Radio(
            robot,
            mission,
            faults=config.links,
            rng=stream(config.trial.seed, Stream.LINKS, robot),
            beacon_s=network.beacon_s,
            delay_s=network.gossip_s,
            clock_error_s=network.clock_error_s,
        )
        self.body = Pilotage(
            mission,
            speed=config.speed,
            period_s=network.control_s,
            lag_s=network.lag_s,
            shield_on=bool(protocol.shield),
        )
        planner = self.thinkers.planners[robot]
        self.mind = Mind(config, agent, planner, self.radio, self.body, self._say)
        link.listen("frame", None, self._frame)
        link.listen("beacon", None, self._beacon)
        link.listen("say", None, self._hear)
        link.listen("mission", robot, self._order)
        link.watch_alive(self._comes_or_goes)

    # ---------------------------------------------------------------- the network

    def _say(self, message: bytes) -> None:
        beacon = self._own_beacon()
        assert beacon is not None, "a robot speaks when it knows where it is"
        self._link.publish("say", self._robot, pack(Saying(beacon=beacon, message=message)))

    def _own_beacon(self) -> Beacon | None:
        position, end = self.body.position, self.body.end
        if position is None or end is None:
            return None
        self._shone = time.monotonic()
        return Beacon(stamp=time.time(), position=position, end=end)

    def _hear(self, sender: int, payload: bytes) -> None:
        try:
            said = unpack(Saying, payload)
            seen = self._placed(sender, said.beacon)
        except MessageError as error:
            self._link.traffic.refused[error.reason] += 1
            return

        def hand_over() -> None:
            self.radio.beacon(sender, seen)
            self.mind.receive(said.message, sender)

        self.radio.deliver(sender, hand_over, self._loop.call_later)

    def _beacon(self, sender: int, payload: bytes) -> None:
        try:
            seen = self._placed(sender, unpack(Beacon, payload))
        except MessageError as error:
            self._link.traffic.refused[error.reason] += 1
            return
        self.radio.deliver(sender, lambda: self.radio.beacon(sender, seen), self._loop.call_later)

    def _placed(self, sender: int, said: Beacon) -> Seen:
        """Where a sender is, told to the radio."""
        dim = self._config.mission.dim
        if len(said.position) != dim or len(said.end) != dim:
            raise MessageError("wrong_length", "a beacon of another dimension")
        now = time.time()
        self._latencies_s.append(now - said.stamp)
        # Who claims to be of the future would look younger than it is.
        seen = Seen(stamp=min(said.stamp, now), position=said.position, end=said.end)
        self.radio.place(sender, seen)
        return seen

    def _frame(self, sender: int, payload: bytes) -> None:
        if sender != WORLD:
            return
        try:
            frame = unpack(Frame, payload)
        except MessageError as error:
            self._link.traffic.refused[error.reason] += 1
            return
        if len(frame.bodies) == self._config.mission.n_robots:
            self.radio.frame(frame.stamp, [body.position for body in frame.bodies])
            self.body.felt(frame.bodies[self._robot])
            self._sees.set()

    def _order(self, sender: int, payload: bytes) -> None:
        if sender == OPERATOR:
            try:
                self.mind.take_order(unpack(Order, payload))
            except MessageError as error:
                self._link.traffic.refused[error.reason] += 1

    def _comes_or_goes(self, number: int, comes: bool) -> None:
        (self._alive.add if comes else self._alive.discard)(number)
        if len(self._alive - {WORLD}) >= self._config.mission.n_robots:
            self._all_here.set()

    def _called(self, attempt: Attempt) -> None:
        self._calls.append(llm_entry(attempt).model_dump(mode="json"))

    # ---------------------------------------------------------------- its life

    async def live(self) -> None:
        """Wait for the own senses, then for the others as long as the configuration says; then begin."""
        network = self._config.network
        await self._sees.wait()
        self._link.be_alive(self._robot)
        try:
            async with asyncio.timeout(network.gather_s), asyncio.TaskGroup() as group:
                beacons = group.create_task(self._shine())
                await self._all_here.wait()
                await asyncio.sleep(3 * network.beacon_s)
                beacons.cancel()
        except TimeoutError:
            pass
        async with asyncio.TaskGroup() as group:
            for task in (self._shine(), self._control(), self.mind.gossip(), self._report(), self._divide()):
                group.create_task(task)
            # Who comes late hears the others out before it begins.
            await asyncio.sleep(2 * network.gossip_s)
            group.create_task(self.mind.live())

    async def _shine(self) -> None:
        """Tell who is near where the body is and where it will stop, unless a message has just told it."""
        network = self._config.network
        phase = phase_s(self._robot, self._config.mission.n_robots, network.gossip_s)
        beat = Beat(network.beacon_s, phase + 0.5 * network.beacon_s)
        while True:
            await beat.next()
            told_s = time.monotonic() - self._shone
            if told_s > ALREADY_TOLD * network.beacon_s and (beacon := self._own_beacon()) is not None:
                self._link.publish("beacon", self._robot, pack(beacon))

    async def _control(self) -> None:
        """Project the way anew in every control period, or with the next news where there was nothing to command."""
        body = self.body
        while True:
            now, command = time.time(), None
            if body.is_free(now):
                command = body.control(now, self.radio.sightings(now), self.radio.unseen_s(now))
            if command is None:
                body.news.clear()
                await body.news.wait()
            else:
                self._link.publish("command", self._robot, pack(command))
                await asyncio.sleep(self._config.network.control_s)

    async def _report(self) -> None:
        beat = Beat(REPORT_S, phase_s(self._robot, self._config.mission.n_robots, self._config.network.gossip_s))
        while True:
            await beat.next()
            calls, self._calls = self._calls, []
            latencies_s, self._latencies_s = self._latencies_s, []
            fields = self.mind.report(known=self._known, calls=calls, latencies_s=latencies_s)
            traffic = self._link.traffic
            fields["rejected"] = {**fields["rejected"], **traffic.refused}
            sent = traffic.sent["say"]
            size = traffic.bytes["say"] + traffic.bytes["beacon"]
            report = Report(stamp=time.time(), sent=sent, bytes=size, **fields)
            self._link.publish("report", self._robot, pack(report))

    async def _divide(self) -> None:
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


async def run_robot(config: SwarmConfig, robot: int, parent: int | None = None) -> None:
    """Be one robot until the process is told to end.

    Args:
        config: the swarm.
        robot: own id.
        parent: process to end with, None to go on without it.

    Raises:
        InputError: no such robot, or an endpoint that cannot be opened.
    """
    mission = config.mission
    if not 0 <= robot < mission.n_robots:
        raise InputError("id", robot, f"0 .. {mission.n_robots - 1}")
    link = open_link(config, robot)
    try:
        one = Robot(config, robot, link)
        try:
            await until_stopped(one.live(), parent=parent)
        finally:
            await one.thinkers.close()
    finally:
        link.close()
