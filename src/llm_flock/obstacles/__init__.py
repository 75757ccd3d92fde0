"""Static obstacles in the flight space: discs (balls in space) and simple polygons, and how far away they are."""

from llm_flock.obstacles.obstacle import Nearest, Obstacle, clearance, segment_clearance

__all__ = ["Nearest", "Obstacle", "clearance", "segment_clearance"]
