"""Static obstacles in the flight space: discs (balls in three dimensions) and simple polygons."""

from llm_flock.obstacles.obstacle import Nearest, Obstacle, clearance, segment_clearance

__all__ = ["Nearest", "Obstacle", "clearance", "segment_clearance"]
