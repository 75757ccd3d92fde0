"""Positions from outside: where the drones are by a motion capture, and how that reaches them.

A source (`PoseSource`) hands over frames of poses, a gate (`PoseGate`) lets through what a drone can have flown, and a
feed (`PoseFeed`) sends the newest accepted pose to each drone at a bounded rate.
"""

from llm_flock_flight._positions.feed import PoseFeed, TakesPoses
from llm_flock_flight._positions.gate import PoseGate

__all__ = ["PoseFeed", "PoseGate", "TakesPoses"]
