"""A run for pages, the same for a finished record, a growing one and a live swarm."""

from __future__ import annotations

import logging
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from llm_flock.arrays import flattened
from llm_flock.printable import printable, shape_title
from llm_flock.record import Entry, FlightEvent, LlmEntry, ProtocolEvent, RoundEnd, RunHistory, protocol_text
from llm_flock_view._viewer.canvases import TOO_CLOSE
from llm_flock_view._viewer.events import track_of_event

logger = logging.getLogger(__name__)

ROUTINE = frozenset({"preflight", "take_off", "aloft", "clipped", "landing", "landed"})
"""Flight events that belong to every flight."""


def close_pairs(positions: Sequence[Sequence[float]], safe: float, downwash: float = 1.0) -> int:
    """Number of pairs nearer than the safe distance [units]."""
    from scipy.spatial import KDTree  # slow to load, and seldom needed

    return len(KDTree(flattened(positions, downwash)).query_pairs(safe - 1e-6))


def box(rows: Sequence[Sequence[float] | None]) -> list[float]:
    """The lowest and then the highest coordinates of some points, 2d numbers [units]; None stands for no point."""
    axes = list(zip(*(row for row in rows if row is not None), strict=True))
    return [*map(min, axes), *map(max, axes)]


def in_unit_square(rows: Sequence[Sequence[float]]) -> list[list[float]]:
    """Points seen from above, in the middle of a picture whose sides are 1 and whose second axis points down."""
    left, bottom, right, top = box([row[:2] for row in rows])
    size = max(right - left, top - bottom, 1e-9)
    middle, centre = (left + right) / 2, (bottom + top) / 2
    return [[round((x - middle) / size + 0.5, 3), round(0.5 - (y - centre) / size, 3)] for x, y, *_ in rows]


def version_of(found: os.stat_result) -> tuple[int, ...]:
    """Numbers that differ between two files, and between a file and what it is after it was written to."""
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _track_of_call(entry: LlmEntry) -> str | None:
    if entry.error is not None:
        return "faults"
    return None if entry.rejected is None else "retries"


class Recording:
    """A run with what pages need beside its history. A sink for record entries; another thread may write."""

    def __init__(self, key: str, title: str, path: Path | None, *, live: bool) -> None:
        self.key = key
        self.title = title
        self.path = path
        self.live = live
        self.history = RunHistory()
        self.open = True
        self.failure: str | None = None
        self.version: tuple[int, ...] | None = None  # of the file as it was read
        self.marks: defaultdict[int, Counter[str]] = defaultdict(Counter)  # of each timeline track, by round
        self.extent: list[float] = []  # where robots and goals have been: two corners [units]
        self.steer: Callable[[], dict[str, Any]] | None = None  # what can be ordered of it now

    def write(self, entry: Entry) -> None:
        """Take an entry of a record; `RoundEnd` makes its round visible."""
        match entry:
            case ProtocolEvent():
                self._mark(entry.round, track_of_event(entry))
            case FlightEvent() if entry.kind not in ROUTINE:
                self._mark(entry.round, "faults")
            case LlmEntry():
                self._mark(entry.round, _track_of_call(entry))
            case RoundEnd():
                self._measure(entry.round)
            case _:
                pass
        self.history.write(entry)

    def _mark(self, number: int, track: str | None) -> None:
        if track is not None:
            self.marks[number][track] += 1

    def _measure(self, number: int) -> None:
        """Count the pairs that are too close, and widen the extent."""
        run = self.history
        if not run.missions or number >= len(run.states):
            return
        state, mission = run.states[number], run.mission_at(number).mission
        safe = float(mission["safe_distance"])
        near = run.rows[number].min_separation if number < len(run.rows) else None
        if near is not None and near < safe:
            pairs = close_pairs(state.positions, safe, mission.get("downwash", 1.0))
            if pairs:
                self.marks[number][TOO_CLOSE] = pairs
        half = len(self.extent) // 2
        known = [self.extent[:half], self.extent[half:]] if self.extent else []
        self.extent = box([*known, *state.positions, *state.goals])

    def fail(self, error: Exception) -> None:
        self.failure = printable(str(error))
        logger.warning("%s", error)

    @property
    def ready(self) -> bool:
        return self.history.last_round >= 0 and bool(self.history.missions)

    @property
    def description(self) -> str:
        """Shape, N, protocol, model and seed; empty while they are not known."""
        run = self.history
        if run.info is None or not run.missions:
            return ""
        config, shape = run.info.config, run.missions[0].mission["shape"]
        model = config.get("model", {}).get("model", "")
        parts = (f"{shape_title(str(shape))} of {run.n_robots}", protocol_text(config), model, f"seed {run.info.seed}")
        return printable(" · ".join(str(part) for part in parts if part))
