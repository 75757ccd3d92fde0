"""A mission as one robot tells it to another: the fields that an operator may change, as JSON."""

from __future__ import annotations

import json
from typing import Any, cast

from llm_flock.errors import InputError, MessageError
from llm_flock.mission import Mission
from llm_flock.protocol.messages.message import Message

MISSION_FIELDS = frozenset({"shape", "points", "center", "spacing", "places", "velocity", "since"})
"""Fields that travel by radio. All other fields belong to the robot, and no message changes them."""


def mission_text(mission: Mission) -> str:
    """The mission's fields as JSON, for a message."""
    return mission.model_dump_json(include=set(MISSION_FIELDS))


def received_mission(message: Message, own: Mission) -> Mission:
    """The mission that a message spells out, with the limits and surroundings of the robot's own mission.

    A sender with other limits announces another digest, so its mission is refused.

    Raises:
        MessageError: with reason `malformed` unless it is a JSON object of `MISSION_FIELDS`, or `other_mission`.
    """
    try:
        decoded: object = json.loads(message.mission_text or "")
    except (ValueError, RecursionError) as error:
        raise MessageError("malformed", f"the mission is not JSON ({error})") from None
    fields = cast("dict[str, Any]", decoded) if isinstance(decoded, dict) else {"": decoded}
    if not fields.keys() <= MISSION_FIELDS:
        raise MessageError("malformed", f"a mission of other fields than {', '.join(sorted(MISSION_FIELDS))}")
    try:
        mission = own.change(**fields)
    except InputError as error:
        raise MessageError("other_mission", str(error)) from None
    if mission.digest != message.mission.digest:
        raise MessageError("other_mission", f"not the mission that {message.mission.digest} stands for")
    return mission
