"""Turns a record into a bag of ROS 2: MCAP with the profile `ros2`, and the topics that a bridge shows live.

A round lasts a second, of a swarm `step_s`; a flight has its own times. A language model's answers stay in the record.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from llm_flock.errors import InputError, RecordError
from llm_flock.extras import require
from llm_flock.record import Entry, MetricsRow, ProtocolEvent, RunRecord, read_record
from llm_flock.runtime import Ros2Config
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.drawing import OK, MarkerDrawer
from llm_flock_swarm._ros2.recorded import RecordedTeam, positions_of, world_of
from llm_flock_swarm._ros2.types import DIAGNOSTICS, MARKERS, NS, PATH, POSE, TEXT, TRANSFORMS, to_cdr, type_store

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer

VERSION = 9  # of rosbag2's format: that of jazzy and later
MAX_TIME_S = 2.0**31  # times in a bag end before this: seconds of ROS are 32 bits [s since 1970]
Put = Callable[[str, str, int, object], None]  # takes the topic, type, time and content of a message


def write_bag(record: Path, out: Path, config: Ros2Config | None = None) -> Path:
    """Write the bag of a record into a folder that must not exist yet. `config` names topics and frame."""
    found = read_record(record)
    require("ros2", "export --ros2bag")
    from rosbags.rosbag2 import StoragePlugin, Writer

    if out.exists() or out.is_symlink():
        raise InputError("out", str(out), "a folder that does not exist: no bag is ever overwritten")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        raise InputError("out", str(out), f"a place that can be written to ({error.strerror})") from None
    try:
        with Writer(folder / out.name, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            _fill(found, config or Ros2Config(), _putter(writer))
        (folder / out.name).rename(out)
    except OSError as error:
        raise RecordError(f"{out}: cannot be written ({error.strerror})") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return out


def _putter(writer: Writer) -> Put:
    connections: dict[str, Any] = {}

    def put(topic: str, kind: str, stamp_ns: int, message: object) -> None:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=type_store())
        writer.write(connections[topic], stamp_ns, to_cdr(message, kind))

    return put


def _fill(found: RunRecord, config: Ros2Config, put: Put) -> None:
    """Write every message, in the order of time."""
    run, n_robots = found.run, found.positions.shape[1]
    swarm, step_s = _of_swarm(run.config.get("network"))
    names, frame = config.namespace(swarm), config.ros_frame
    to_world, unit_m = world_of(run, found.mission, config.unit_m, found.positions.shape[2])
    team, drawer = RecordedTeam(to_world, unit_m), MarkerDrawer(frame)
    spaces = [f"{names}/robot_{robot}" for robot in range(n_robots)]
    times = _round_times(found, step_s)
    begin_ns = _began_ns(run.created_at)
    entries: dict[int, list[Entry]] = defaultdict(list)
    for entry in (*found.missions, *found.plans, *found.bodies, *found.states, *found.events, *found.metrics):
        entries[getattr(entry, "round", 0)].append(entry)

    def stamped(time_s: float) -> int:
        if not 0 <= begin_ns / NS + time_s < MAX_TIME_S:
            raise RecordError(f"{found.path}: a time of {time_s:g} s has no place in a bag")
        return begin_ns + round(time_s * NS)

    def put_poses(positions: list[drawing.Position], stamp_ns: int) -> None:
        for space, at in zip(spaces, positions, strict=True):
            put(f"{space}/pose", POSE, stamp_ns, drawing.pose(at, stamp_ns, frame))
        frames = [space[1:] for space in spaces]
        put("/tf", TRANSFORMS, stamp_ns, drawing.transforms(positions, frames, stamp_ns, frame))

    def put_samples(first: int, last: float) -> None:
        for sample in found.bodies:
            if first <= sample.round <= last and len(sample.measured) == n_robots:
                put_poses(positions_of(sample), stamped(sample.time_s))

    for state in found.states:
        for entry in entries[state.round]:
            team.take(entry)
        put_samples(state.round, state.round)
        view, stamp_ns = team.view(), stamped(times[state.round])
        assert view is not None, "a record has a mission before its first state"
        if not found.bodies:
            put_poses(list(view.positions), stamp_ns)
        for robot, space in enumerate(spaces):
            put(f"{space}/path", PATH, stamp_ns, drawing.path(view, robot, stamp_ns, frame))
        put(f"{names}/markers", MARKERS, stamp_ns, drawer.draw(view, stamp_ns))
        put(f"{names}/state", TEXT, stamp_ns, drawing.text(team.state_json()))
        for entry in entries[state.round]:
            if isinstance(entry, MetricsRow):
                values = entry.model_dump(exclude_none=True)
                content = drawing.diagnostics([(f"{names[1:]}: team", OK, "", values)], stamp_ns, names[1:])
                put("/diagnostics", DIAGNOSTICS, stamp_ns, content)
            elif isinstance(entry, ProtocolEvent):
                put(f"{names}/events", TEXT, stamp_ns, drawing.text(entry.model_dump(mode="json", exclude_none=True)))
    put_samples(found.rounds + 1, math.inf)  # a flight may end within a round


def _of_swarm(network: object) -> tuple[str, float]:
    """The name of a recorded swarm, and the time between two of its rounds [s]; those of other runs without one."""
    fields = cast("dict[str, object]", network) if isinstance(network, dict) else {}
    name, step_s = fields.get("swarm"), fields.get("step_s")
    lasts_s = float(step_s) if isinstance(step_s, int | float) and 0.0 < step_s < MAX_TIME_S else 1.0
    return name[:64] if isinstance(name, str) and name else "flock", lasts_s


def _round_times(found: RunRecord, step_s: float) -> dict[int, float]:
    """When each round was over [s]: by the last sample of a flight, or as if all lasted as long."""
    times = {state.round: state.round * step_s for state in found.states}
    if found.bodies:
        last = 0.0
        ends = {sample.round: sample.time_s for sample in found.bodies}
        for number in sorted(times):
            last = times[number] = max(last, ends.get(number, last))
    return times


def _began_ns(created_at: str) -> int:
    """The run's begin [ns since 1970]; that of the clock where the record does not say it."""
    try:
        moment = datetime.fromisoformat(created_at)
        aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        return max(0, round(aware.timestamp() * NS))
    except (ValueError, OverflowError):
        return 0
