"""Reads a record while it is being written: each time what came whole since the last time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.records import Channel, Footer, Message
from mcap.stream_reader import StreamReader

from llm_flock.errors import RecordError
from llm_flock.record.raw import RawMessage, WholeReads, entry_of
from llm_flock.record.schema import CHANNELS, ROUND_NS, Entry


class RecordTail:
    """Goes through a record that may still grow.

    Args:
        path: the file; it may be made later.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ended = False
        self._at = 0
        self._topics: dict[int, str] = {}

    def new(self) -> Iterator[Entry]:
        """Every entry that came since the last call, in the order of writing; none while there is no file.

        Raises:
            RecordError: the file cannot be read, is damaged other than at its end, or is of a newer format.
        """
        try:
            size = self.path.stat().st_size
            if self.ended or size <= self._at:
                return
            with self.path.open("rb") as file:
                file.seek(self._at)
                # No record can be longer than the file; without the limit, room for a broken length would be asked for.
                stream = StreamReader(
                    WholeReads(file),  # pyright: ignore[reportArgumentType]
                    skip_magic=self._at > 0,
                    record_size_limit=size,
                )
                for record in stream.records:
                    self._at = file.tell()
                    if isinstance(record, Channel):
                        self._topics[record.id] = record.topic
                    elif isinstance(record, Message):
                        topic = self._topics[record.channel_id]
                        model = CHANNELS.get(topic)
                        if model is not None:
                            number = record.log_time // ROUND_NS
                            yield entry_of(self.path, model, RawMessage(topic=topic, round=number, data=record.data))
                    elif isinstance(record, Footer):
                        self.ended = True
                        return
        except (EndOfFile, RecordLengthLimitExceeded):
            return  # the rest of this record is still to be written
        except FileNotFoundError:
            return
        except OSError as error:
            raise RecordError(f"{self.path}: cannot be read ({error.strerror})") from None
        except (McapError, KeyError, UnicodeDecodeError) as error:
            raise RecordError(f"{self.path}: not a readable MCAP file ({error})") from error
