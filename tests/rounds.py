"""The event that begins a round, and the observation in it, from what a robot senses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from llm_flock.arrays import Point
from llm_flock.events import RoundBegan
from llm_flock.protocol._parts import Observation


def round_began(
    number: int, position: Point, sensed: Mapping[int, Point] | None = None, degree: int | None = None
) -> RoundBegan:
    """The beginning of a round.

    Args:
        number: of the round.
        position: of the robot [units].
        sensed: positions of the robots that it senses, by id [units]; all of them are shown to its planner.
        degree: number of robots that the radio counts within range; as many as are sensed if left out.
    """
    others = sensed or {}
    return RoundBegan(
        round=number,
        position=position,
        degree=len(others) if degree is None else degree,
        sensed=others,
        observed=tuple(others.values()),
    )


def observation(position: Point, sensed: Mapping[int, Point], **more: Any) -> Observation:
    """What a robot observes, with further fields of `Observation`."""
    return Observation(position=position, sensed=sensed, **more)
