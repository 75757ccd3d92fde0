"""Writes a record while the run happens.

The file is unchunked: every message is a record of its own, so all that reached the disk can be read. The beginning and
each complete round go to the operating system, so a killed process loses no complete round. A machine that loses power
may. The file is locked while it is written, so that no program deletes the record of a run in flight.
"""

from __future__ import annotations

import json
import logging
import os
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from mcap.writer import IndexType, Writer

from llm_flock.errors import InputError, RecordError
from llm_flock.printable import one_line
from llm_flock.record._schema import (
    CHANNELS,
    ROUND_NS,
    SCENE_TOPIC,
    TOPICS,
    Entry,
    FlightEvent,
    MissionInfo,
    PlanInfo,
    RecordSink,
    RoundEnd,
    RunInfo,
    State,
    SummaryMessage,
    channel_schema,
)

if TYPE_CHECKING:
    from llm_flock.record._scene import SceneDrawer

logger = logging.getLogger(__name__)

LIBRARY = "llm-flock"
BUFFER_BYTES = 1 << 20
"""Larger than most rounds, so that the file usually grows by whole rounds [bytes]."""


class Tee:
    """A sink that passes everything on to others, in their order."""

    def __init__(self, *sinks: RecordSink) -> None:
        self._sinks = sinks

    def write(self, entry: Entry) -> None:
        """Write an entry to all of them."""
        for sink in self._sinks:
            sink.write(entry)


class Guarded:
    """A part that only looks on, as a function or a sink: its first error ends the part, and nothing else.

    The error is logged, and kept in `ended` under the part's name; parts of one name end together.
    """

    def __init__(self, name: str, work: Callable[..., object] | None, ended: dict[str, Exception]) -> None:
        self._name, self._work, self._ended = name, work, ended

    def __call__(self, *args: Any) -> None:
        """Do the work, unless the part has ended."""
        if self._work is not None and self._name not in self._ended:
            try:
                self._work(*args)
            except Exception as error:  # noqa: BLE001 - whatever it is, it must not end a flight
                self._ended[self._name] = error
                logger.warning("the %s ends here, and the robots fly on: %s", self._name, one_line(repr(error)))

    write = __call__


def both(*sinks: RecordSink | None) -> RecordSink | None:
    """One sink for several, each of which may be missing."""
    there = [sink for sink in sinks if sink is not None]
    return Tee(*there) if len(there) > 1 else there[0] if there else None


def check_new(path: Path) -> None:
    """Check that a new file can be written here. Call before the work that it is to hold; makes missing folders."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        allowed = os.access(path.parent, os.W_OK | os.X_OK)
    except OSError as error:
        raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None
    if os.path.lexists(path):
        raise InputError("out", str(path), "a place where nothing is: nothing is ever overwritten")
    if not allowed:
        raise InputError("out", str(path), "a place that can be written to (Permission denied)")


@cache
def _schemas() -> tuple[tuple[str, str, bytes], ...]:
    """Topic, name and JSON schema of every channel: the same in each record of a process."""
    from llm_flock.record._scene import scene_schema

    ours = [(topic, "llm_flock.", channel_schema(model)) for topic, model in CHANNELS.items()]
    return tuple(
        (topic, package + schema["title"], json.dumps(schema, separators=(",", ":")).encode())
        for topic, package, schema in (*ours, (SCENE_TOPIC, "", scene_schema()))
    )


class RecordWriter:
    """A sink that writes one new MCAP file; a context manager. RecordError if the disk fails."""

    def __init__(self, path: Path) -> None:
        self.path = path
        check_new(path)
        try:
            self._file = path.open("xb", buffering=BUFFER_BYTES)
        except OSError as error:
            raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None
        from llm_flock.file_lock import lock_file

        lock_file(self._file.fileno())
        self._mcap = Writer(
            self._file, use_chunking=False, index_types=IndexType.NONE, use_summary_offsets=False, enable_crcs=True
        )
        self._mcap.start(library=LIBRARY)
        self._sequence: Counter[str] = Counter()
        self._channels: dict[str, int] = {}
        for topic, name, text in _schemas():
            number = self._mcap.register_schema(name, "jsonschema", text)
            self._channels[topic] = self._mcap.register_channel(topic, "json", number)
        self._scene: SceneDrawer | None = None
        self._last_round = 0
        self._broken = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def write(self, entry: Entry) -> None:
        """Write an entry to its channel; a state, which comes after the first mission, is also drawn as a scene."""
        if self._scene is None and isinstance(entry, State):
            raise RecordError(f"{self.path}: a state comes before the mission")
        number: int = getattr(entry, "round", self._last_round)
        try:
            self._put(TOPICS[type(entry)], entry.encoded(), number)
            if self._scene is not None and isinstance(entry, State):
                self._put(SCENE_TOPIC, self._scene.draw(entry), number)
            elif isinstance(entry, RunInfo | RoundEnd | SummaryMessage | FlightEvent):
                self._last_round = number
                self._file.flush()  # to the operating system, with all that came before
        except OSError as error:
            raise self._failure(error) from error
        if isinstance(entry, MissionInfo):
            # Plans keep their colours in the next mission; sizes and ranges never change.
            from llm_flock.record._scene import SceneDrawer

            self._scene = self._scene or SceneDrawer(entry)
        elif isinstance(entry, PlanInfo) and self._scene is not None:
            self._scene.know([entry.plan_id])

    def close(self) -> None:
        """Write the end of the file, unless writing has failed, and close it. May be called twice."""
        if self._file.closed:
            return
        try:
            with self._file:
                if not self._broken:  # a message may have been written in part
                    self._mcap.finish()
                if not os.fstat(self._file.fileno()).st_nlink:
                    raise RecordError(f"{self.path}: was removed while it was written")
        except OSError as error:
            raise self._failure(error) from error

    def _put(self, topic: str, data: bytes, number: int) -> None:
        time = number * ROUND_NS
        self._mcap.add_message(self._channels[topic], time, data, time, self._sequence[topic])
        self._sequence[topic] += 1

    def _failure(self, error: OSError) -> RecordError:
        self._broken = True
        return RecordError(f"{self.path}: cannot be written ({error.strerror})")
