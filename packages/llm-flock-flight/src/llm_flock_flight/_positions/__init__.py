"""Positions from outside: sends drones their poses by a motion capture.

A source (`PoseSource`) hands over frames of poses, a gate (`PoseGate`) lets through what a drone can have flown, and a
feed (`PoseFeed`) sends the newest accepted pose to each drone at a bounded rate.
"""

from llm_flock_flight._positions.feed import PoseFeed, TakesPoses
from llm_flock_flight._positions.gate import PoseGate

__all__ = ["PoseFeed", "PoseGate", "TakesPoses"]
