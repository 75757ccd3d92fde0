"""Reads a record message by message, also while it is being written. Needs no numpy: a first page loads quickly."""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

import zstandard
from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.records import Channel, Chunk, Footer, Header, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from pydantic import ValidationError

from llm_flock.errors import FlockError, RecordError
from llm_flock.record import MAGIC, RECORD_NAME
from llm_flock.record._schema import (
    CHANNELS,
    FORMAT_VERSION,
    ROUND_NS,
    Entry,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    RoundEnd,
    RunInfo,
    State,
)

ROS_BAG = "a bag of ROS 2, not a record of a run; `ros2 bag info` and Foxglove read it"

_NO_MCAP = (ArithmeticError, AssertionError, LookupError, RuntimeError, ValueError)
"""Errors that the libraries raise, besides their own, on bytes that are no MCAP file."""

MAX_UNPACKED, RATIO = 16 << 20, 50
"""Chunks of a record unpack to at most the first [bytes], plus the second times the size of the file."""


def record_file(path: str | Path) -> Path:
    """The file of a record, given by its own name or its folder's. RecordError for an invalid path."""
    try:
        given = Path(path).expanduser()
    except (TypeError, RuntimeError):
        raise RecordError(f"{path!r}: a record is given by the path of its file or folder") from None
    return given / RECORD_NAME if given.is_dir() else given


@dataclass(frozen=True, slots=True, kw_only=True)
class RawMessage:
    """One message as it stands in the file: its channel, the round at which it was logged, and its JSON."""

    topic: str
    round: int
    data: bytes

    def decoded(self) -> dict[str, Any]:
        """The message as plain values; `RecordError` if it is no JSON object."""
        try:
            value: object = json.loads(self.data)
        except (ValueError, RecursionError) as error:
            raise RecordError(f"{self.topic} of round {self.round} is no JSON ({error})") from None
        if not isinstance(value, dict):
            raise RecordError(f"{self.topic} of round {self.round} is no JSON object")
        return cast("dict[str, Any]", value)


class _Team:
    """Checks that entries belong to one record: its robots, its dimension of space, and its order of rounds."""

    def __init__(self) -> None:
        self._n: int | None = None
        self._dim: int | None = None
        self.begun = False
        self._counts: Counter[type[Entry]] = Counter()
        self._first: int | None = None

    def objection(self, entry: Entry) -> str | None:
        """The reason why an entry does not fit those before it, or None."""
        if not self.begun:
            self.begun = isinstance(entry, RunInfo)
            return None if self.begun else "not a record of a run: /run comes first"
        match entry:
            case MissionInfo(mission=fields):
                self._first = entry.round if self._first is None else min(self._first, entry.round)
                return self._differs(fields["n_robots"], *map(len, (*fields["arena"], *(entry.ideal or ()))))
            case PlanInfo(points=points):
                return self._differs(None, *map(len, points))
            case State() | MetricsRow() | RoundEnd():
                fault, due = None, self._counts[type(entry)]
                self._counts[type(entry)] += 1
                if isinstance(entry, State):
                    if self._first is None or self._first > entry.round:
                        return "a state before the first mission"
                    fault = self._differs(len(entry.positions), *map(len, entry.positions[:1]))
                elif isinstance(entry, RoundEnd) and not self._counts[State] == self._counts[MetricsRow] == due + 1:
                    return "not a record of a run: a round without /state or /metrics"
                return fault or (None if entry.round == due else f"round {entry.round} where round {due} was due")
            case ProtocolEvent(robot=robot) | LlmEntry(robot=robot) if self._n is not None and robot >= self._n:
                return f"robot {robot} in a team of {self._n}"
            case _:
                return None

    def _differs(self, n: int | None, *dims: int) -> str | None:
        self._n = n if self._n is None else self._n
        self._dim = dims[0] if self._dim is None and dims else self._dim
        if n is not None and n != self._n:
            return f"{n} robots, not {self._n} as before"
        return "positions of different numbers of coordinates" if {*dims} - {self._dim} else None


class RecordStream:
    """Reads a record from its start; `messages` and `entries` go on where the last call stopped.

    The file may be created later, and may still grow until `ended`: its proper end was reached.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ended = False
        self._position = 0
        self._topics: dict[int, str] = {}
        self._team = _Team()

    def entries(self) -> Iterator[Entry]:
        """Every new entry, checked, in the order of writing; `/scene` and unknown channels are skipped."""
        for message in self.messages():
            model = CHANNELS.get(message.topic)
            if model is None:
                if not self._team.begun:
                    raise RecordError(f"{self.path}: not a record of a run: {message.topic} comes before /run")
                continue
            try:
                if model is RunInfo and (version := message.decoded().get("format_version")) != FORMAT_VERSION:
                    raise RecordError(f"format version {version!r:.40}; this release reads version {FORMAT_VERSION}")
                entry = model.model_validate_json(message.data)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                where = ".".join(str(part) for part in first["loc"])
                says = f"{message.topic} of round {message.round} is not valid ({where}: {first['msg']})"
                raise RecordError(f"{self.path}: {says}") from None
            except FlockError as error:
                raise RecordError(f"{self.path}: {error}") from None
            objection = self._team.objection(entry)
            if objection is not None:
                raise RecordError(f"{self.path}: {message.topic} of round {message.round} is not valid ({objection})")
            yield entry

    def messages(self) -> Iterator[RawMessage]:
        """Every message that was completed since the last call; none while there is no file."""
        try:
            size = self.path.stat().st_size
            if self.ended or size <= self._position:
                return
            with self.path.open("rb") as file:
                if not MAGIC.startswith(file.read(len(MAGIC))):
                    raise RecordError(f"{self.path}: not a readable MCAP file (it does not begin like one)")
                file.seek(self._position)
                # No record is longer than the file: without the limit, a damaged length would request much memory.
                whole: Any = _WholeReads(file, size)
                stream = StreamReader(whole, self._position > 0, emit_chunks=True, record_size_limit=size)
                for record in self._unpacked(stream.records, size):
                    self._position = file.tell()
                    if isinstance(record, Header) and record.profile == "ros2":
                        raise RecordError(f"{self.path}: {ROS_BAG}")
                    if isinstance(record, Channel):
                        self._topics[record.id] = record.topic
                    elif isinstance(record, Message):
                        topic = self._topics[record.channel_id]
                        yield RawMessage(topic=topic, round=record.log_time // ROUND_NS, data=record.data)
                    elif isinstance(record, Footer):
                        self.ended = True
                        return
        except (EndOfFile, RecordLengthLimitExceeded, FileNotFoundError):
            return  # the rest of this record is not written (yet); all before it is whole
        except OSError as error:
            raise RecordError(f"{self.path}: cannot be read ({error.strerror})") from None
        except (McapError, zstandard.ZstdError, struct.error, *_NO_MCAP) as error:
            raise RecordError(f"{self.path}: not a readable MCAP file ({error})") from error

    def _unpacked(self, records: Iterable[McapRecord], size: int) -> Iterator[McapRecord]:
        """The records, also those in chunks of other programs. A few bytes must not unpack to gigabytes."""
        left = MAX_UNPACKED + RATIO * size
        for record in records:
            if not isinstance(record, Chunk):
                yield record
                continue
            data = _unpack(record, min(left, record.uncompressed_size))
            left -= len(data)
            yield from breakup_chunk(replace(record, compression="", data=data))


def _unpack(chunk: Chunk, most: int) -> bytes:
    """The bytes of a chunk. McapError if their number is not as stated, or more than `most`."""
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                data = reader.read(most + 1)
        case _:
            raise McapError(f"unknown compression {chunk.compression!r:.20}")
    if len(data) != chunk.uncompressed_size:
        raise McapError("a chunk of another size than it says")
    return data


class _WholeReads:
    """Reads exactly as many bytes as asked for, or reports the end of the file."""

    def __init__(self, file: BufferedReader, size: int) -> None:
        self._file, self._size = file, size

    def read(self, length: int) -> bytes:
        if length > self._size - self._file.tell():  # first: memory for a broken length would be requested
            raise EndOfFile
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        return data
