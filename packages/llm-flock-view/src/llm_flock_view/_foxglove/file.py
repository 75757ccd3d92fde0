"""Converts a record for Foxglove: in chunks with an index, with the arena, trails and a pose channel for each robot.

A record is written so that a killed run can be read, which makes it slow to search. This file is compressed, and a
player finds any time in it at once. It holds the record's own channels too, so this program reads it like a record.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from mcap.writer import CompressionType, Writer

from llm_flock.errors import InputError, RecordError
from llm_flock.record import LIBRARY, ROUND_NS, MissionInfo, RecordStream
from llm_flock_view._figures.style import whole_file
from llm_flock_view._foxglove.channels import ChannelWriter, channel_kinds


def write_file(record: Path, target: Path) -> int:
    """Write a record as an indexed MCAP file, and return its number of messages. An older export is replaced.

    The record is read entry by entry, so it may be larger than memory. Nothing is left behind where it cannot be read.

    Raises:
        RecordError: the record cannot be read, or holds no round.
        InputError: the target cannot be written to, or is the record itself.
    """
    if not record.is_file():
        raise RecordError(f"{record}: no such record")
    if target.exists() and target.samefile(record):
        raise InputError("out", str(target), "another place than the record itself")
    with whole_file(target) as part:
        return _write(record, part)


def _write(record: Path, part: Path) -> int:
    channels, drawn, sequence = dict[str, int](), ChannelWriter(), Counter[str]()
    with part.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD, use_chunking=True)
        writer.start(library=LIBRARY)
        for topic, number in _register(writer, 0).items():
            channels[topic] = number
        for entry in RecordStream(record).entries():
            if isinstance(entry, MissionInfo):
                channels |= _register(writer, int(entry.mission["n_robots"]), set(channels))
            for message in drawn.messages(entry):
                time = message.round * ROUND_NS
                writer.add_message(channels[message.topic], time, message.data, time, sequence[message.topic])
                sequence[message.topic] += 1
        if not sequence["/state"]:
            raise RecordError(f"{record}: the run ended before its start was recorded; there is nothing to export")
        writer.finish()
    return sequence.total()


def _register(writer: Writer, n_robots: int, known: set[str] | None = None) -> dict[str, int]:
    """Register the channels of a team that are not known yet; those of one kind share a schema."""
    schemas, found = dict[str, int](), dict[str, int]()
    for topic, kind in channel_kinds(n_robots).items():
        if known is not None and topic in known:
            continue
        if kind.name not in schemas:
            text = json.dumps(kind.schema, separators=(",", ":")).encode()
            schemas[kind.name] = writer.register_schema(kind.name, "jsonschema", text)
        found[topic] = writer.register_channel(topic, "json", schemas[kind.name])
    return found
