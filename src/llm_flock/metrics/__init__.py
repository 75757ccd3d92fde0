"""Metrics of a run: shape error, separation, agreement, and whether the team has formed.

Points have the shape (n, d), lengths are in mission units. Lists have an item for each robot: None for a robot without
a plan or a slot, an infinite distance for a robot without a goal.
"""

from llm_flock.metrics.agreement import (
    AT_GOAL,
    HELD_ROUNDS,
    IN_SHAPE,
    FormedTracker,
    bottleneck_distance,
    deadline,
    distinct_goals,
    lower_bound_rounds,
    plans_in_use,
    robots_at_goal,
)
from llm_flock.metrics.plane import quick_error
from llm_flock.metrics.separation import StartSeparation, min_separation, segment_separation
from llm_flock.metrics.shape_error import ShapeError, ShapeTarget, procrustes

__all__ = [
    "AT_GOAL",
    "HELD_ROUNDS",
    "IN_SHAPE",
    "FormedTracker",
    "ShapeError",
    "ShapeTarget",
    "StartSeparation",
    "bottleneck_distance",
    "deadline",
    "distinct_goals",
    "lower_bound_rounds",
    "min_separation",
    "plans_in_use",
    "procrustes",
    "quick_error",
    "robots_at_goal",
    "segment_separation",
]
