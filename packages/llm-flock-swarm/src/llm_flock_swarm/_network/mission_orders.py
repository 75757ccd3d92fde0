"""Orders that change a swarm's mission, and the check of the operator's signature on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from llm_flock.members import OPERATOR
from llm_flock.message import MissionStamp
from llm_flock.mission import MISSION_FIELDS, OPTIONAL, Mission
from llm_flock_swarm._network.config import SwarmConfig, check_still, check_unsigned
from llm_flock_swarm._network.connection import load_keys
from llm_flock_swarm._network.wire import MissionOrder
from llm_flock_swarm._signed.certificates import mission_statement


def changed_mission(mission: Mission, fields: Mapping[str, Any]) -> Mission:
    """The mission with these fields changed. InputError for one that a swarm of processes cannot fly."""
    changed = mission.change(**fields)
    check_still(changed)
    return changed


def mission_order(config: SwarmConfig, fields: dict[str, Any], counter: int) -> MissionOrder:
    """An order that changes these fields of the mission; with keys it is signed, and holds the whole mission."""
    keys, mission = load_keys(config, OPERATOR), changed_mission(config.mission, fields)
    config.check_missions(mission)
    if keys is None:
        return MissionOrder(fields=fields, counter=counter)
    check_unsigned(config, mission)
    whole = {**OPTIONAL, **mission.model_dump(mode="json", include=set(MISSION_FIELDS))}
    signature = keys.sign(mission_statement(MissionStamp(counter, mission.digest)))
    return MissionOrder(fields=whole, counter=counter, signature=signature)


def mission_verifier(config: SwarmConfig, member: int) -> Callable[[MissionStamp, bytes], bool] | None:
    """A function that checks the operator's signature on a mission; None in a team without keys."""
    keys = load_keys(config, member)
    if keys is None:
        return None
    return lambda stamp, signature: keys.check(OPERATOR, mission_statement(stamp), signature)
