"""Connects a process to a swarm's network: open, or secured with the keys of the team."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError, MessageError
from llm_flock.extras import require
from llm_flock.members import OPERATOR, WORLD, member_name, members
from llm_flock.message import MISSION_FIELDS, MissionStamp
from llm_flock_swarm._network.accusations import contexts
from llm_flock_swarm._network.config import SwarmConfig, endpoints
from llm_flock_swarm._network.wire import MissionOrder, T, unpack
from llm_flock_swarm._signed.certificates import mission_statement
from llm_flock_swarm._zenoh import (
    MAX_SEALED_BYTES,
    ROOT,
    PlainSeal,
    Seal,
    ZenohLink,
    access_control,
    open_session,
    settings,
)

if TYPE_CHECKING:
    from llm_flock_swarm._trust.keys import Keyring

logger = logging.getLogger(__name__)

FAULT = "fault"  # reason under which input is counted that met an error in this program
REPORT_S = 0.2  # time between two reports to observers [s]
ORDER_S = 1.0  # shortest time between two orders of an operator, in the long run [s]
LOGGED = 3  # faults that are logged; a flood of them must not fill the disk
SPARE = 4.0  # a sender may send this many times as often as the configuration says: late messages come together


def rates(config: SwarmConfig) -> dict[str, float]:
    """Messages a second that one sender may bring, by kind."""
    network = config.network
    periods = {
        "say": network.gossip_s,
        "beacon": network.beacon_s,
        "frame": network.frame_s,
        "command": network.control_s,
        "report": REPORT_S,
        "mission": ORDER_S,
    }
    return {kind: SPARE / period for kind, period in periods.items()}


def _may_send(config: SwarmConfig) -> dict[str, list[str]]:
    """Keys under which each member of a team may send and be alive, by the name in its certificate."""
    root, n = f"{ROOT}/{config.network.swarm}", config.mission.n_robots
    of_others = {WORLD: [f"frame/{WORLD}", f"alive/{WORLD}"], OPERATOR: ["mission/*"]}
    of_robots = {j: [f"{kind}/{j}" for kind in ("say", "beacon", "report", "command", "alive")] for j in range(n)}
    return {
        member_name(member): [f"{root}/{topic}" for topic in {**of_others, **of_robots}.get(member, [])]
        for member in members(n)
    }


def load_keys(config: SwarmConfig, member: int) -> Keyring | None:
    """A member's keys; None where the swarm uses none. InputError: missing, damaged, or of another team size."""
    folder = config.network.keys
    if folder is None:
        return None
    require("network", "--keys")
    from llm_flock_swarm._trust.keys import load_keyring

    keys = load_keyring(Path(folder), member)
    if keys.robots != config.mission.n_robots:
        raise InputError("keys", folder, f"keys of {config.mission.n_robots} robots, not of {keys.robots}")
    return keys.for_flight(config.network.swarm)


def open_link(config: SwarmConfig, member: int, listen: str | None = None) -> ZenohLink:
    """Join as a robot, or as WORLD, OPERATOR or WATCHER; call in a running event loop.

    With keys every endpoint uses TLS, however it is written. `listen` replaces the configuration's own endpoints.
    """
    network, keys = config.network, load_keys(config, member)
    listens, connects = endpoints(network.listen if listen is None else listen), endpoints(network.connect)
    security: dict[str, Any] | None = None
    seal: Seal = PlainSeal(member)
    if keys is not None and network.keys is not None:
        from llm_flock_swarm._trust.envelope import Envelope
        from llm_flock_swarm._trust.session import next_session
        from llm_flock_swarm._trust.tls import tls_config

        folder = Path(network.keys)
        listens, connects = ([end.replace("tcp/", "tls/", 1) for end in ends] for ends in (listens, connects))
        security = {**tls_config(folder, member), **access_control(_may_send(config))}
        seal = Envelope(keys, next_session(folder, member, time.time()), max_payload=MAX_SEALED_BYTES)
    session = open_session(settings(listen=listens, connect=connects, lease_s=network.lease_s, security=security))
    loop = asyncio.get_running_loop()
    return ZenohLink(
        session, swarm=network.swarm, own=member, seal=seal, loop=loop, rates=rates(config), contexts=contexts(config)
    )


def receive(
    link: ZenohLink,
    kind: str,
    message: type[T],
    handler: Callable[[int, T], None],
    *,
    number: int | None = None,
    sender: int | None = None,
) -> None:
    """Have a handler called in the event loop with the sender and content of every message of a kind.

    With a `number`, only messages to this id count, on a topic that belongs to its receiver; with a `sender`, only its
    own. What cannot be decoded, is refused, or meets an error in this program is counted: no message ends the process.
    """

    def take(source: int, payload: bytes) -> None:
        if sender not in (None, source):
            return
        with refusing(link.traffic.refused):
            handler(source, unpack(message, payload))

    link.listen(kind, number, take)


def signed_by_operator(config: SwarmConfig, member: int) -> Callable[[MissionStamp, bytes], bool] | None:
    """What tells a member whether the operator signed a mission; None in a team without keys."""
    keys = load_keys(config, member)
    if keys is None:
        return None
    return lambda stamp, signature: keys.check(OPERATOR, mission_statement(stamp), signature)


@contextmanager
def refusing(refused: Counter[str]) -> Generator[None]:
    """Count input that is refused in here, or that meets an error in this program, instead of failing on it."""
    try:
        yield
    except MessageError as error:
        refused[error.reason] += 1
    except Exception as error:
        refused[FAULT] += 1
        if refused[FAULT] <= LOGGED:
            logger.warning("input dropped: %s: %s", type(error).__name__, error, exc_info=error)


def mission_order(config: SwarmConfig, fields: dict[str, Any], ordered_at: int) -> MissionOrder:
    """An order that changes these fields of the mission; with keys it is signed, and holds the whole mission."""
    keys, counter = load_keys(config, OPERATOR), ordered_at
    if keys is None:
        return MissionOrder(fields=fields, counter=counter)
    mission = config.mission.change(**fields)
    whole = mission.model_dump(mode="json", include=set(MISSION_FIELDS))
    signature = keys.sign(mission_statement(MissionStamp(counter, mission.digest)))
    return MissionOrder(fields=whole, counter=counter, signature=signature)
