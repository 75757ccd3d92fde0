"""Turns a record into a bag of ROS 2: MCAP with the profile `ros2`, and the topics that a bridge shows live.

A round lasts one second, or `step_s` in a record of a swarm. A flight keeps its measured times. Answers of language
models are left out.
"""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from llm_flock.errors import RecordError
from llm_flock.extras import require
from llm_flock.record import BodySample, Entry, MetricsRow, ProtocolEvent, RunRecord, check_new, read_record
from llm_flock.runtime import Ros2Config
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.drawing import OK, MarkerDrawer
from llm_flock_swarm._ros2.recorded import RecordedTeam, positions_of, world_of
from llm_flock_swarm._ros2.types import DIAGNOSTICS, MARKERS, NS, PATH, POSE, TEXT, TRANSFORMS, to_cdr, type_store

if TYPE_CHECKING:
    from rosbags.rosbag2 import Writer

VERSION = 9  # of rosbag2's format: that of jazzy and later
MAX_TIME_S = 2.0**31  # times in a bag end before this: seconds of ROS are 32 bits [s since 1970]


def write_bag(record: Path, out: Path, config: Ros2Config | None = None) -> Path:
    """Write the bag of a record into a folder that must not exist yet. `config` names topics and frame."""
    contents = read_record(record)
    require("ros2", "export --ros2bag")
    from rosbags.rosbag2 import StoragePlugin, Writer

    check_new(out)
    try:
        with TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as folder:
            with Writer(Path(folder) / out.name, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
                _BagWriter(writer, contents, config or Ros2Config()).write()
            (Path(folder) / out.name).rename(out)
    except OSError as error:
        raise RecordError(f"{out}: cannot be written ({error.strerror})") from error
    return out


class _BagWriter:
    """Writes the messages of one record, in the order of time."""

    def __init__(self, writer: Writer, record: RunRecord, config: Ros2Config) -> None:
        self._writer, self._record, self._frame = writer, record, config.ros_frame
        name, step_s = _swarm_settings(record.run.config.get("network"))
        self._namespace, n_robots = config.namespace(name), record.positions.shape[1]
        self._robot_namespaces = [f"{self._namespace}/robot_{robot}" for robot in range(n_robots)]
        to_world, unit_m = world_of(record.run, record.mission, config.unit_m, record.positions.shape[2])
        self._team, self._drawer = RecordedTeam(to_world, unit_m), MarkerDrawer(self._frame)
        self._connections: dict[str, Any] = {}
        self._start_ns, self._times = _start_ns(record.run.created_at), _round_times(record, step_s)

    def write(self) -> None:
        record, entries = self._record, defaultdict[int, list[Entry]](list)
        samples = defaultdict[int, list[BodySample]](list)
        for entry in (*record.missions, *record.plans, *record.bodies, *record.states, *record.events, *record.metrics):
            entries[getattr(entry, "round", 0)].append(entry)
        for sample in record.bodies:
            samples[min(sample.round, record.rounds + 1)].append(sample)
        for state in record.states:
            self._write_round(state.round, entries[state.round], samples[state.round])
        self._put_samples(samples[record.rounds + 1])  # a flight may end within a round

    def _write_round(self, number: int, entries: list[Entry], samples: list[BodySample]) -> None:
        for entry in entries:
            self._team.take(entry)
        self._put_samples(samples)
        view, stamp_ns = self._team.view(), self._stamp_ns(self._times[number])
        assert view is not None, "a record has a mission before its first state"
        if not self._record.bodies:
            self._put_poses(list(view.positions), stamp_ns)
        for robot, namespace in enumerate(self._robot_namespaces):
            self._put(f"{namespace}/path", PATH, stamp_ns, drawing.path(view, robot, stamp_ns, self._frame))
        namespace = self._namespace
        self._put(f"{namespace}/markers", MARKERS, stamp_ns, self._drawer.draw(view, stamp_ns))
        self._put(f"{namespace}/state", TEXT, stamp_ns, drawing.text(self._team.state_json()))
        for entry in entries:
            if isinstance(entry, MetricsRow):
                source, values = namespace[1:], entry.model_dump(exclude_none=True)
                content = drawing.diagnostics([(f"{source}: team", OK, "", values)], stamp_ns, source)
                self._put("/diagnostics", DIAGNOSTICS, stamp_ns, content)
            elif isinstance(entry, ProtocolEvent):
                content = drawing.text(entry.model_dump(mode="json", exclude_none=True))
                self._put(f"{namespace}/events", TEXT, stamp_ns, content)

    def _put_samples(self, samples: list[BodySample]) -> None:
        for sample in samples:
            if len(sample.measured) == len(self._robot_namespaces):
                self._put_poses(positions_of(sample), self._stamp_ns(sample.time_s))

    def _put_poses(self, positions: list[drawing.Position], stamp_ns: int) -> None:
        for namespace, position in zip(self._robot_namespaces, positions, strict=True):
            self._put(f"{namespace}/pose", POSE, stamp_ns, drawing.pose(position, stamp_ns, self._frame))
        frames = [namespace[1:] for namespace in self._robot_namespaces]
        self._put("/tf", TRANSFORMS, stamp_ns, drawing.transforms(positions, frames, stamp_ns, self._frame))

    def _put(self, topic: str, kind: str, stamp_ns: int, message: object) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=type_store())
        self._writer.write(self._connections[topic], stamp_ns, to_cdr(message, kind))

    def _stamp_ns(self, time_s: float) -> int:
        if not 0 <= self._start_ns / NS + time_s < MAX_TIME_S:
            raise RecordError(f"{self._record.path}: a time of {time_s:g} s has no place in a bag")
        return self._start_ns + round(time_s * NS)


def _swarm_settings(network: object) -> tuple[str, float]:
    """Name and round period [s] of a recorded swarm; `flock` and 1 s for other runs."""
    fields = cast("dict[str, object]", network) if isinstance(network, dict) else {}
    name, step_s = fields.get("swarm"), fields.get("step_s")
    period_s = float(step_s) if isinstance(step_s, int | float) and 0.0 < step_s < MAX_TIME_S else 1.0
    return name[:64] if isinstance(name, str) and name else "flock", period_s


def _round_times(record: RunRecord, step_s: float) -> dict[int, float]:
    """End time of each round [s]: the last sample of a flight, else rounds of equal length."""
    times = {state.round: state.round * step_s for state in record.states}
    if record.bodies:
        last = 0.0
        ends = {sample.round: sample.time_s for sample in record.bodies}
        for number in sorted(times):
            last = times[number] = max(last, ends.get(number, last))
    return times


def _start_ns(created_at: str) -> int:
    """Start of the run [ns since 1970]; 0, the epoch, if the record does not say."""
    try:
        moment = datetime.fromisoformat(created_at)
        aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        return max(0, round(aware.timestamp() * NS))
    except (ValueError, OverflowError):
        return 0
