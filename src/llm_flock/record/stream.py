"""Reads a record message by message, also while it is being written. Needs no numpy: a first page waits for it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.records import Channel, Footer, Message
from mcap.stream_reader import StreamReader
from pydantic import ValidationError

from llm_flock.errors import RecordError
from llm_flock.record.schema import CHANNELS, FORMAT_VERSION, ROUND_NS, Entry, RunInfo


@dataclass(frozen=True, slots=True, kw_only=True)
class RawMessage:
    """One message as it stands in the file: its channel, the round at which it was logged, and its JSON."""

    topic: str
    round: int
    data: bytes

    def decoded(self) -> dict[str, Any]:
        """The message as plain values."""
        return json.loads(self.data)


class RecordStream:
    """Reads a record from its start; `messages` and `entries` go on where the last call stopped.

    The file may be created later, and may still grow.

    Attributes:
        ended: whether the file's proper end was reached, so that no more will come.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ended = False
        self._position = 0
        self._topics: dict[int, str] = {}

    def entries(self) -> Iterator[Entry]:
        """Every new entry, in the order of writing; `/scene` and unknown channels are skipped.

        Raises:
            RecordError: as `messages`; or an entry is not valid, or of a newer format.
        """
        for message in self.messages():
            model = CHANNELS.get(message.topic)
            if model is None:
                continue
            if model is RunInfo and (version := message.decoded().get("format_version")) != FORMAT_VERSION:
                says = f"format version {version!r}; this release reads version {FORMAT_VERSION}"
                raise RecordError(f"{self.path}: {says}")
            try:
                yield model.model_validate_json(message.data)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                where = ".".join(str(part) for part in first["loc"])
                says = f"{message.topic} of round {message.round} is not valid ({where}: {first['msg']})"
                raise RecordError(f"{self.path}: {says}") from None

    def messages(self) -> Iterator[RawMessage]:
        """Every message that was completed since the last call; none while there is no file.

        Raises:
            RecordError: the file cannot be read, or is damaged other than at its end.
        """
        try:
            size = self.path.stat().st_size
            if self.ended or size <= self._position:
                return
            with self.path.open("rb") as file:
                file.seek(self._position)
                # No record is longer than the file; without the limit, memory for a broken length would be requested.
                stream = StreamReader(
                    _WholeReads(file),  # pyright: ignore[reportArgumentType]
                    skip_magic=self._position > 0,
                    record_size_limit=size,
                )
                for record in stream.records:
                    self._position = file.tell()
                    if isinstance(record, Channel):
                        self._topics[record.id] = record.topic
                    elif isinstance(record, Message):
                        topic = self._topics[record.channel_id]
                        yield RawMessage(topic=topic, round=record.log_time // ROUND_NS, data=record.data)
                    elif isinstance(record, Footer):
                        self.ended = True
                        return
        except (EndOfFile, RecordLengthLimitExceeded, FileNotFoundError):
            return  # the rest of this record was not written (yet); what came before is whole
        except OSError as error:
            raise RecordError(f"{self.path}: cannot be read ({error.strerror})") from None
        except (McapError, KeyError, UnicodeDecodeError) as error:
            raise RecordError(f"{self.path}: not a readable MCAP file ({error})") from error


class _WholeReads:
    """Reads exactly as many bytes as asked for, or reports the end of the file: half a record is not a short record."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file

    def read(self, length: int) -> bytes:
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        return data
