"""One message of a record, as it stands in the file and as what it stands for. A first look needs it: no numpy here."""

from __future__ import annotations

import json
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeVar

from mcap.exceptions import EndOfFile
from pydantic import ValidationError

from llm_flock.errors import RecordError
from llm_flock.record.schema import FORMAT_VERSION, Entry, RunInfo

E = TypeVar("E", bound=Entry)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawMessage:
    """One message as it stands in the file.

    Attributes:
        topic: its channel.
        round: the round at which it was logged.
        data: its JSON.
    """

    topic: str
    round: int
    data: bytes

    def decoded(self) -> dict[str, Any]:
        """The message as plain values."""
        return json.loads(self.data)


def entry_of(path: Path, model: type[E], message: RawMessage) -> E:
    """A message as what it stands for.

    Raises:
        RecordError: it is not valid, or of a newer format.
    """
    if model is RunInfo:
        version = message.decoded().get("format_version")
        if version != FORMAT_VERSION:
            raise RecordError(f"{path}: format version {version!r}; this release reads version {FORMAT_VERSION}")
    try:
        return model.model_validate_json(message.data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise RecordError(
            f"{path}: {message.topic} of round {message.round} is not valid ({where}: {first['msg']})"
        ) from None


class WholeReads:
    """Bytes of a file that may break off anywhere: half a record is the end, not a short record."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file

    def read(self, length: int) -> bytes:
        """Exactly `length` bytes.

        Raises:
            EndOfFile: there are fewer left.
        """
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        return data
