"""Follows the entries of a record or of a live flight, and derives the state that ROS 2 shows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from llm_flock.arrays import Point
from llm_flock.errors import InputError, RecordError
from llm_flock.mission import MISSION_FIELDS
from llm_flock.record import BodySample, Entry, MissionInfo, PlanInfo, RunInfo, State
from llm_flock.runtime import WorldConfig
from llm_flock.validation import checked
from llm_flock_swarm._ros2.drawing import Position, TeamView, ToWorld, scaled, view_of


def world_of(run: RunInfo, mission: MissionInfo, unit_m: float | None, dim: int) -> tuple[ToWorld, float]:
    """How units become metres in `dim` dimensions, and the length of one [m]; a flight's record says it itself."""
    if "world" not in run.config or unit_m is not None:
        return scaled(unit_m or 1.0), unit_m or 1.0
    try:
        world = checked(WorldConfig, run.config["world"])
    except InputError as error:
        raise RecordError(f"the flight's place in the world cannot be read: {error}") from None
    low, high = (tuple(corner) for corner in mission.mission["arena"])
    if not len(low) == len(high) == dim:
        raise RecordError(f"corners of an arena with {len(low)} and {len(high)} coordinates, not {dim}")
    return world.frame(low, high).to_world, world.scale_m


class RecordedTeam:
    """The newest state of a team, entry by entry."""

    def __init__(self, to_world: ToWorld, unit_m: float) -> None:
        self.state: State | None = None
        self._to_world, self._unit_m = to_world, unit_m
        self._mission: MissionInfo | None = None
        self._places: dict[str, list[Point]] = {}
        self._measured: list[Position] | None = None

    def take(self, entry: Entry) -> None:
        """Take note of an entry; those of other kinds are ignored."""
        match entry:
            case MissionInfo():
                self._mission = entry
            case PlanInfo():
                self._places[entry.plan_id] = [tuple(point) for point in entry.points]
            case State():
                self.state = entry
            case BodySample():
                self._measured = positions_of(entry)
            case _:
                pass

    def view(self) -> TeamView | None:
        """The team as of now, where drones measured themselves if they did; None before the first state."""
        if self.state is None or self._mission is None:
            return None
        fields = self._mission.mission
        view = view_of(
            self.state,
            self._to_world,
            safe_m=float(fields["safe_distance"]) * self._unit_m,
            downwash=float(fields.get("downwash", 1.0)),
            comm_range=float(fields["comm_range"]),
            places=self._places,
        )
        measured = self._measured
        if measured is None or len(measured) != len(view.positions):
            return view
        return replace(view, positions=measured)

    def state_json(self) -> dict[str, Any]:
        state, mission = self.state, self._mission
        if state is None or mission is None:
            return {}
        none: list[list[str]] = [[] for _ in state.phases]
        robots = [
            {"id": robot, "phase": phase, "plan": plan, "slot": slot, "origin": origin, "breakers": breakers}
            for robot, (phase, plan, slot, origin, breakers) in enumerate(
                zip(state.phases, state.plan_ids, state.slots, state.origins, state.open_breakers or none, strict=True)
            )
        ]
        fields = {name: value for name, value in mission.mission.items() if name in MISSION_FIELDS}
        return {"round": state.round, "mission": fields, "robots": robots}


def positions_of(sample: BodySample) -> list[Position]:
    return [(x, y, z) for x, y, z in ((*row, 0.0, 0.0, 0.0)[:3] for row in sample.measured)]
