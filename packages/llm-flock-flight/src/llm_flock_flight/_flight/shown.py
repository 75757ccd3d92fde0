"""ROS 2, which shows a flight while it happens and may provide its poses: a plug-in of the kind `flights`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from typing import Protocol, cast

from llm_flock import plugins
from llm_flock.extras import ExtraMissing
from llm_flock.record import RecordSink
from llm_flock.robots import PoseSource
from llm_flock.runtime import MissionFrame, Ros2Config


class FlightBridge(Protocol):
    """What the plug-in has to offer."""

    def prepare(self) -> None:
        """Load what takes time. Call before drones take off."""
        ...

    def poses_of(self, config: Ros2Config, drones: Sequence[str]) -> PoseSource:
        """The source of these drones' poses."""
        ...

    def showing_flight(
        self, config: Ros2Config, drones: Sequence[str], frame: MissionFrame, low_battery_v: float
    ) -> AbstractAsyncContextManager[RecordSink]:
        """A sink that shows a flight; no fault of it reaches a drone. Raises InputError if it cannot begin."""
        ...


def ros2_bridge() -> FlightBridge:
    """The bridge to ROS 2; raises ExtraMissing. Call only for a flight that uses it."""
    try:
        return cast("FlightBridge", plugins.load("flights", "ros2"))
    except KeyError:
        raise ExtraMissing("ROS 2", "ros2") from None
