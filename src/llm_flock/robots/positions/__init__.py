"""Positions from outside: where the drones are by a motion capture, and how that reaches them.

A source (`PoseSource`) hands over frames of poses, a gate (`PoseGate`) lets through what a drone can have flown, and a
feed (`PoseFeed`) sends the newest accepted pose to each drone at a bounded rate.
"""

from llm_flock.robots.positions.feed import PoseFeed
from llm_flock.robots.positions.gate import GateLimits, PoseGate
from llm_flock.robots.positions.pose import Pose, PoseFrame, PoseSource, TakesPoses, TellsSenders

__all__ = ["GateLimits", "Pose", "PoseFeed", "PoseFrame", "PoseGate", "PoseSource", "TakesPoses", "TellsSenders"]
