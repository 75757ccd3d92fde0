"""Writes a record as a file for the Rerun viewer: robots, trails, goals, walls, measurements and events, by rounds."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from llm_flock.extras import require
from llm_flock.printable import one_line
from llm_flock.record import NO_PLAN, RunRecord
from llm_flock_view._figures.style import heading, plan_looks, whole_file

APPLICATION = "llm-flock"
TIMELINE = "round"
TRAIL = 24
"""Longest trail [rounds]."""

MAX_LINE_LENGTH = 400  # longest line of the log [characters]

FIGURES = ("procrustes_mean", "plans_in_use", "distinct_goals", "robots_at_goal", "segment_separation", "model_calls")


def write_rerun(record: RunRecord, target: Path) -> None:
    """Write a record as an .rrd file. An older one is replaced.

    Raises:
        InputError: the extra is not installed, or the target cannot be written to.
    """
    require("rerun", "export --rerun")
    rr: Any = import_module("rerun")  # too large to be installed for type checks
    with whole_file(target) as part:
        part.touch()  # the SDK does not say why it cannot write
        stream = rr.RecordingStream(APPLICATION, recording_id=f"{record.run.seed}-{record.run.created_at}")
        stream.save(str(part), default_blueprint=_blueprint())
        _write(record, stream)
        stream.flush()
        stream.disconnect()


def _write(record: RunRecord, stream: Any) -> None:
    rr: Any = import_module("rerun")
    looks, radius = plan_looks(record), float(record.mission.mission["safe_distance"]) / 2
    points = _in_space(record.positions)
    stream.log("about", rr.TextDocument(heading(record, 20)), static=True)
    for mission in record.missions:
        stream.set_time(TIMELINE, sequence=mission.round)
        stream.log("world/arena", rr.LineStrips3D(_walls(mission.mission), colors=[0x56606BFF]))
    for number, (state, row) in enumerate(zip(record.states, record.metrics, strict=True)):
        stream.set_time(TIMELINE, sequence=number)
        colours = [_rgb(looks[plan].fill if plan is not None else NO_PLAN) for plan in state.plan_ids]
        labels = [str(robot) for robot in range(len(colours))]
        stream.log("world/robots", rr.Points3D(points[number], radii=radius, colors=colours, labels=labels))
        goals = [k for k, goal in enumerate(state.goals) if goal is not None]
        at = _in_space(np.array([state.goals[k] for k in goals], dtype=np.float64)) if goals else np.empty((0, 3))
        stream.log("world/goals", rr.Points3D(at, radii=radius / 2, colors=[colours[k] for k in goals]))
        trails = points[max(0, number - TRAIL) : number + 1].swapaxes(0, 1)
        stream.log("world/trails", rr.LineStrips3D(list(trails), colors=colours))
        for name in FIGURES:
            value = getattr(row, name)
            if value is not None:
                stream.log(f"metrics/{name}", rr.Scalars(float(value)))
    for event in record.events:
        stream.set_time(TIMELINE, sequence=event.round)
        details = ", ".join(f"{name} {value}" for name, value in event.detail.items() if value is not None)
        stream.log("events", rr.TextLog(one_line(f"robot {event.robot}: {event.kind} {details}", MAX_LINE_LENGTH)))


def _blueprint() -> Any:
    rrb: Any = import_module("rerun.blueprint")
    plots: list[Any] = [
        rrb.TimeSeriesView(origin=f"metrics/{name}", name=name.replace("_", " ")) for name in FIGURES[:1]
    ]
    counts = [f"metrics/{name}" for name in ("plans_in_use", "distinct_goals", "robots_at_goal")]
    plots.append(rrb.TimeSeriesView(contents=counts, name="agreement"))
    plots.append(rrb.TimeSeriesView(origin="metrics/segment_separation", name="smallest distance"))
    side = rrb.Vertical(*plots, rrb.TextLogView(origin="events", name="events"))
    return rrb.Blueprint(rrb.Horizontal(rrb.Spatial3DView(origin="world", name="team"), side, column_shares=[3, 2]))


def _in_space(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions of shape (..., 2 or 3) as (..., 3); a plane lies at height 0."""
    missing = 3 - rows.shape[-1]
    return np.concatenate([rows, np.zeros((*rows.shape[:-1], missing))], axis=-1)


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))


def _walls(mission: dict[str, Any]) -> list[list[list[float]]]:
    """Walls and obstacles as lines, each closed: seen from above at the floor, and at the ceiling of a room."""
    low, high = mission["arena"]
    outlines: list[list[list[float]]] = [[low[:2], [high[0], low[1]], high[:2], [low[0], high[1]]]]
    for obstacle in mission.get("obstacles", ()):
        polygon, center, radius = obstacle.get("polygon"), obstacle.get("center"), obstacle.get("radius")
        if polygon is not None:
            outlines.append([row[:2] for row in polygon])
        elif center is not None and radius is not None:
            outlines.append(_circle(center, radius))
    heights: Iterable[float] = (low[2], high[2]) if len(low) == 3 else (0.0,)
    return [[[*row, z] for row in [*outline, outline[0]]] for outline in outlines for z in heights]


def _circle(center: list[float], radius: float) -> list[list[float]]:
    turns = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    return np.column_stack([center[0] + radius * np.cos(turns), center[1] + radius * np.sin(turns)]).tolist()
