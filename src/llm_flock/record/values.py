"""Values in a record on which its readers rely, whoever wrote it: finite numbers, types, and what belongs together.

A record may come from anywhere. What is checked here need not be checked where a record is shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self, cast

from pydantic import AfterValidator, BaseModel, Field, model_validator

from llm_flock.bounds import MAX_CORNERS, MAX_OBSTACLES, MAX_ROBOTS

Finite = Annotated[float, Field(ge=-1e15, le=1e15, allow_inf_nan=False)]
"""A figure: far more than any run reaches, and no trouble for the arithmetic of drawings."""

Coordinate = Annotated[float, Field(ge=-1e12, le=1e12, allow_inf_nan=False)]
"""A thousand times what missions accept, and no trouble for the arithmetic of drawings."""

Row = Annotated[list[Coordinate], Field(min_length=2, max_length=3)]
"""One position, d coordinates [units; world frame]."""

Length = Annotated[float, Field(ge=1e-6, le=1e12, allow_inf_nan=False)]
"""A length that divides others [units]."""

LARGEST_WHOLE = 2**53

Whole = Annotated[int, Field(ge=-LARGEST_WHOLE, le=LARGEST_WHOLE)]
"""A whole number that every reader of JSON can hold."""

Count = Annotated[int, Field(ge=0, le=LARGEST_WHOLE)]

Round = Annotated[int, Field(ge=0, le=10**9)]
Robot = Annotated[int, Field(ge=0, le=10**6)]

Rows = Annotated[list[Row], Field(max_length=MAX_ROBOTS)]
"""One position for each of several robots or places."""

DEEPEST = 32
"""Deepest nesting of free values; those of this program have a quarter of it."""


def check_plain(value: object, depth: int = DEEPEST) -> None:
    """Check that every reader of JSON can hold a value; ValueError for other numbers, and for deeper nesting."""
    if isinstance(value, Mapping | list | tuple):
        if depth == 0:
            raise ValueError("values are nested too deeply")
        held = (
            cast("Mapping[str, object]", value).values() if isinstance(value, Mapping) else cast("list[object]", value)
        )
        for one in held:
            check_plain(one, depth - 1)
    elif isinstance(value, int | float) and not -1e300 <= value <= 1e300:
        raise ValueError("a number that readers cannot hold")
    elif not isinstance(value, str | int | float | None):
        raise ValueError(f"a value of type {type(value).__name__}")


def _free(values: dict[str, Any]) -> dict[str, Any]:
    check_plain(values)
    return values


Free = Annotated[dict[str, Any], AfterValidator(_free)]
"""Values by name, of a form that this format does not know."""


_Corner = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


class _Obstacle(BaseModel):
    center: Row | None = None
    radius: Annotated[Coordinate, Field(ge=0)] | None = None
    polygon: Annotated[list[_Corner], Field(min_length=3, max_length=MAX_CORNERS)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.polygon is None and (self.center is None or self.radius is None):
            raise ValueError("an obstacle is a polygon, or has center and radius")
        return self


class _MissionFields(BaseModel):
    """Fields of a mission on which readers of records rely; versions of this program may write more."""

    shape: str
    n_robots: Annotated[int, Field(ge=1, le=MAX_ROBOTS)]
    spacing: Length
    safe_distance: Length
    comm_range: Length
    arena: Annotated[list[Row], Field(min_length=2, max_length=2)]
    places: Whole | None = None
    obstacles: Annotated[list[_Obstacle], Field(max_length=MAX_OBSTACLES)] = []

    @model_validator(mode="after")
    def _check(self) -> Self:
        low, high = self.arena
        if len(low) != len(high) or any(b - a < 1e-6 for a, b in zip(low, high, strict=True)):
            raise ValueError("arena is not two corners, each lower < upper")
        if any(one.center is not None and len(one.center) != len(low) for one in self.obstacles):
            raise ValueError("obstacles have another number of coordinates than the arena")
        if sum(len(one.polygon or ()) for one in self.obstacles) > MAX_CORNERS:
            raise ValueError(f"obstacles have more than {MAX_CORNERS} corners")
        return self


def _mission_fields(mission: dict[str, Any]) -> dict[str, Any]:
    _MissionFields.model_validate(mission)
    return _free(mission)


def _config(config: dict[str, Any]) -> dict[str, Any]:
    for name in ("protocol", "model"):
        if not isinstance(config.get(name, {}), dict):
            raise ValueError(f"{name} is a section of the configuration, with fields of its own")
    return _free(config)


_DETAILS: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("plan", "question", "by", "state", "shape", "about", "cause", "model", "proof"), (str,)),
    **dict.fromkeys(("from", "slot", "before", "wait", "refusals", "robot"), (int,)),
    **dict.fromkeys(("proposed", "flown", "vacant", "slots", "missing"), (list, tuple)),
}
"""Types of details of events, by name, on which readers rely; all may be null."""


def _details(detail: dict[str, Any]) -> dict[str, Any]:
    for name, value in detail.items():
        wanted = _DETAILS.get(name, object)
        if value is not None and (not isinstance(value, wanted) or (wanted == (int,) and isinstance(value, bool))):
            raise ValueError(f"{name} is not a value of type {type(value).__name__}")
    return _free(detail)


class _ResultFields(BaseModel):
    """Figures of a summary on which readers rely."""

    formed: bool | None = None
    stopped: str | None = None
    rounds_to_formed: Whole | None = None
    plan_robot: Robot | None = None
    plan_by: str | None = None
    waypoint_shares: dict[str, Finite] | None = None
    breakers_opened: list[Robot] | None = None


def _result_fields(result: dict[str, Any]) -> dict[str, Any]:
    _ResultFields.model_validate(result)
    return _free(result)


Config = Annotated[dict[str, Any], AfterValidator(_config)]
"""A configuration under current names, section by section."""

MissionFields = Annotated[dict[str, Any], AfterValidator(_mission_fields)]
Details = Annotated[dict[str, Any], AfterValidator(_details)]
Figures = Annotated[dict[str, Any], AfterValidator(_result_fields)]
