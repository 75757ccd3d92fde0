"""The settings of the bridge to ROS 2: router, names, frame, units, and accepted input."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import Field, field_validator

from llm_flock.errors import InputError
from llm_flock.runtime._config import ConfigSection, number

NAME = r"[A-Za-z_][A-Za-z0-9_]*"  # a token of a ROS name

_PATH: Any = {
    "pattern": rf"^{NAME}(/{NAME})*$",
    "max_length": 128,
    "json_schema_extra": {
        "expected": "names with slashes between them, such as lab/flock: letters, digits and _, no digit first"
    },
}

ROBOT = "{id}"  # stands for a robot's id in `ros_pose_topic`


def is_endpoint(text: str) -> bool:
    """Whether a text has the form of a zenoh endpoint: PROTOCOL/ADDRESS, with a port if the protocol has ports."""
    protocol, slash, address = text.partition("/")
    if protocol not in ("tcp", "udp", "tls", "quic", "ws"):
        return bool(slash and address and re.fullmatch(r"[a-z][a-z0-9-]*", protocol))
    port = re.fullmatch(r"[^\s/]+:([0-9]{1,5})(?:[?#].*)?", address)
    return port is not None and int(port[1]) < 65536


class Ros2Config(ConfigSection):
    """The bridge to ROS 2. It runs where a `router` is given."""

    router: str | None = Field(
        default=None,
        max_length=256,
        json_schema_extra={"flag": "ros2"},
        description="Appear in ROS 2 by its zenoh router (rmw_zenohd) at this endpoint, such as tcp/127.0.0.1:7447",
    )
    ros_domain: int = Field(default=0, ge=0, le=232, description="ROS_DOMAIN_ID")
    ros_namespace: str | None = Field(
        default=None, description="Namespace of the team's nodes and topics; the swarm's name if unset", **_PATH
    )
    ros_frame: str = Field(default="world", description="Frame of all positions", **_PATH)
    ros_rate_hz: float = number(10.0, "Poses of each robot per second", least=0.1, most=100)
    unit_m: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        allow_inf_nan=False,
        description="Length of one mission unit [m]; 1 if unset. A flight has `scale_m` for it",
    )
    use_sim_time: bool = Field(
        default=False,
        description="Stamp by /clock: publish it for simulated bodies, follow it with poses from ROS",
    )
    ros_missions: bool = Field(default=False, description="Take missions from ROS, as the operator of the swarm")
    ros_poses: bool = Field(
        default=False, description="Take the robots' poses from ROS as their sensors, in place of the world process"
    )
    ros_pose_topic: str | None = Field(
        default=None,
        max_length=256,
        description="Topic of a robot's sensed pose, with {id} for its number; sensed_pose in its namespace if unset",
    )

    @field_validator("router")
    @classmethod
    def _check_router(cls, endpoint: str | None) -> str | None:
        if endpoint is not None and not is_endpoint(endpoint):
            raise InputError("router", endpoint, "an endpoint such as tcp/127.0.0.1:7447")
        return endpoint

    @field_validator("ros_pose_topic")
    @classmethod
    def _check_pose_topic(cls, topic: str | None) -> str | None:
        if topic is None:
            return None
        named = topic.replace(ROBOT, "0")
        if topic.count(ROBOT) != 1 or not re.fullmatch(rf"/?{NAME}(/{NAME})*", named):
            raise InputError("ros_pose_topic", topic, "a ROS topic with {id} once, such as /mocap/robot_{id}/pose")
        return "/" + topic.lstrip("/")

    def namespace(self, team: str) -> str:
        """The namespace with its slash, made of the team's name if none is configured."""
        if self.ros_namespace is not None:
            return f"/{self.ros_namespace}"
        token = re.sub(r"[^A-Za-z0-9_]", "_", team)
        return f"/_{token}" if token[:1].isdigit() else f"/{token}"

    def pose_topic(self, team: str) -> str:
        """Topic of a robot's sensed pose, with `{id}` for its number."""
        return self.ros_pose_topic or f"{self.namespace(team)}/robot_{ROBOT}/sensed_pose"


def refuse_ros2(flags: Mapping[str, Any], says: str) -> None:
    """Refuse typed flags of ROS 2. Settings of ROS 2 in a file are ignored."""
    for field in Ros2Config.model_fields:
        if flags.get(field) is not None:
            raise InputError(field, flags[field], says=says)
