"""Drives vehicles that speak MAVLink: copters with PX4 or ArduPilot.

pymavlink is under the LGPL, version 3, so it is an extra (`pip install 'llm-flock[mavlink]'`), and only
`llm_flock_flight._mavlink.codec` imports it. Flown with stand-ins only: no autopilot
and no simulator of one was tried.
"""

from llm_flock_flight._mavlink.frames import Geodetic, LocalFrame
from llm_flock_flight._mavlink.port import Ports
from llm_flock_flight._mavlink.robot import MavlinkRobot

__all__ = ["Geodetic", "LocalFrame", "MavlinkRobot", "Ports"]
