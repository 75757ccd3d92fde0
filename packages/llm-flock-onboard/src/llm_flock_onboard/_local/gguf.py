"""Read the header of a GGUF file: metadata and the places of its tensors, but none of their numbers.

Format: GGUF version 2 and 3 as llama.cpp writes them, little-endian.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError

_SCALARS = {0: "B", 1: "b", 2: "H", 3: "h", 4: "I", 5: "i", 6: "f", 7: "?", 10: "Q", 11: "q", 12: "d"}
_STRING, _ARRAY = 8, 9
_MAX_DIMS = 4
_MAX_VALUES = 1 << 16
"""Most values, and most tensors: models have some hundreds of each."""

_MAX_STRINGS = 1 << 21
"""Most strings in lists; the largest vocabularies, with their merges, have a third of it."""

_MAX_TEXT = 1 << 24
"""Names and texts together [bytes]; chat templates have some ten thousand, and names some fifty each."""

_TOKENS = "tokenizer.ggml.tokens"
_SIZES = (
    "block_count",
    "context_length",
    "embedding_length",
    "attention.head_count",
    "attention.head_count_kv",
    "attention.key_length",
    "attention.value_length",
)
"""Values that are numbers of things where they are given as one number; larger than 2^31 are none."""


@dataclass(frozen=True, slots=True)
class Tensor:
    """One entry of the list of tensors: the `shape` begins with the fastest axis, `format` is llama.cpp's number.

    `offset` counts from the beginning of all tensor data. Byte `entry` of the file is where both stand, in 4 and 8
    bytes.
    """

    shape: tuple[int, ...]
    format: int
    offset: int
    entry: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """The header of a GGUF file: metadata without lists, and tensors in the order of the file.

    The tensor data begins at byte `data_begin`, each tensor at a multiple of `alignment` from there.
    """

    metadata: Mapping[str, Any]
    tensors: Mapping[str, Tensor]
    data_begin: int
    alignment: int

    @property
    def is_adapter(self) -> bool:
        """Whether the file holds a LoRA adapter instead of a model."""
        return self.metadata.get("general.type") == "adapter"

    @property
    def trained_context(self) -> int | None:
        """Context length of the training [tokens], None where the file does not tell."""
        return self._number("context_length")

    @property
    def cache_bytes(self) -> int:
        """Memory for the keys and values of one token [bytes], 0 where the file does not tell."""
        layers, heads, width = (self._number(n) for n in ("block_count", "attention.head_count", "embedding_length"))
        if layers is None or not heads or width is None:
            return 0
        key = self._number("attention.key_length") or width // heads
        value = self._number("attention.value_length") or width // heads
        return layers * (self._number("attention.head_count_kv") or heads) * (key + value) * 2  # in half precision

    def _number(self, name: str) -> int | None:
        value = self.metadata.get(f"{self.metadata.get('general.architecture')}.{name}")
        return value if isinstance(value, int) else None


def read_header(path: Path) -> Header:
    """Read the header of a GGUF file, again only after the file has changed; InputError if it is none."""
    try:
        found = path.stat()
    except OSError as error:
        raise InputError("model", str(path), f"a file that is there ({error.strerror})") from None
    try:
        return _header(path, found.st_mtime_ns)
    except OSError as error:
        raise InputError("model", str(path), f"a readable file ({error.strerror})") from None
    except (ValueError, KeyError, OverflowError, struct.error):
        raise InputError("model", str(path), "a GGUF file of version 2 or 3") from None


@lru_cache(maxsize=16)
def _header(path: Path, _changed: int) -> Header:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return _Reader(data).header()


class _Reader:
    """Reads a file from its beginning; ValueError, KeyError or struct.error where it is malformed."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self._strings = self._text_bytes = self._listed = self._vocabulary = 0

    def header(self) -> Header:
        if self._data.read(4) != b"GGUF" or self._scalar("I") not in (2, 3):
            raise ValueError
        n_tensors, n_values = self._scalar("Q"), self._scalar("Q")
        if max(n_tensors, n_values) > _MAX_VALUES:
            raise ValueError
        metadata: dict[str, Any] = {}
        for _ in range(n_values):
            name = self._text()
            value = self._value(self._scalar("I"))
            if name == _TOKENS:
                self._vocabulary = self._listed
            if value is not None:
                metadata[name] = value
        tensors: dict[str, Tensor] = {}
        for _ in range(n_tensors):
            name, dims = self._text(), self._scalar("I")
            if dims > _MAX_DIMS:
                raise ValueError
            shape = tuple(self._scalar("Q") for _ in range(dims))
            tensors[name] = Tensor(shape, entry=self._data.tell(), format=self._scalar("I"), offset=self._scalar("Q"))
        for name in ("bos", "eos"):
            token = metadata.get(f"tokenizer.ggml.{name}_token_id")
            added = metadata.get(f"tokenizer.ggml.add_{name}_token") is True and token is not None
            if added and (type(token) is not int or not 0 <= token < self._vocabulary):  # the engine would abort
                raise ValueError
        alignment = metadata.get("general.alignment", 32)
        if not isinstance(alignment, int) or not 0 < alignment <= 1 << 16:
            raise ValueError
        architecture = metadata.get("general.architecture")
        for size in (metadata.get(f"{architecture}.{name}", 1) for name in _SIZES):
            if type(size) is not int or not 0 < size < 2**31:
                raise ValueError
        end = self._data.tell()
        return Header(metadata=metadata, tensors=tensors, data_begin=end + -end % alignment, alignment=alignment)

    def _value(self, kind: int) -> Any:
        """One value; a list is skipped and gives None."""
        if kind == _STRING:
            return self._text()
        if kind != _ARRAY:
            return self._scalar(_SCALARS[kind])
        inner, count = self._scalar("I"), self._scalar("Q")
        self._listed = count
        if inner == _STRING:
            self._skip_strings(count)
        else:
            self._data.seek(count * struct.calcsize(_SCALARS[inner]), os.SEEK_CUR)
        return None

    def _skip_strings(self, count: int) -> None:
        self._strings += count
        if self._strings > _MAX_STRINGS:
            raise ValueError
        at, length = self._data.tell(), struct.Struct("<Q")
        for _ in range(count):
            at += length.size + length.unpack_from(self._data, at)[0]
        self._data.seek(at)

    def _scalar(self, form: str) -> Any:
        (value,) = struct.unpack("<" + form, self._data.read(struct.calcsize("<" + form)))
        return value

    def _text(self) -> str:
        length = self._scalar("Q")
        self._text_bytes += length
        if self._text_bytes > _MAX_TEXT:
            raise ValueError
        text = self._data.read(length)
        if len(text) < length:
            raise ValueError
        return text.decode("utf-8", "replace")
