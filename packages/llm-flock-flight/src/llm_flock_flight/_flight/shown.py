"""ROS 2, which shows a flight while it happens and may provide its poses: a plug-in of the kind `flights`."""

from __future__ import annotations

from typing import Any

from llm_flock import plugins
from llm_flock.extras import ExtraMissing


def ros2_bridge() -> Any:
    """The bridge to ROS 2, `llm_flock_swarm._ros2.flight`, for a flight that uses it; or ExtraMissing."""
    try:
        return plugins.load("flights", "ros2")
    except KeyError:
        raise ExtraMissing("ROS 2", "ros2") from None
