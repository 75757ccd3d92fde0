"""The head of a GGUF file: what it says of itself, and where its tensors are, without any of their numbers.

Format: version 2 and 3 as llama.cpp writes them, little-endian.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError

_SCALARS = {0: "B", 1: "b", 2: "H", 3: "h", 4: "I", 5: "i", 6: "f", 7: "?", 10: "Q", 11: "q", 12: "d"}
_STRING, _ARRAY = 8, 9
_MAX_DIMS = 4
_ALIGNMENT = 32
"""Tensors begin at multiples of so many bytes unless the file says otherwise."""

_CACHE_BYTES = 2
"""Bytes of a number in the cache of keys and values (half precision)."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the numbers of a tensor are, and how they are written.

    Attributes:
        format: llama.cpp's number of it.
        begin: first byte, counted from where the tensors begin.
    """

    format: int
    begin: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """What stands at the beginning of a GGUF file.

    Attributes:
        about: what the file says of itself; lists are left out.
        tensors: size of each tensor by its name, fastest axis first.
        places: where each tensor is, by its name; in the order of the file, as `tensors`.
        list_begin: first byte of the list of tensors.
        list_end: first byte behind it.
    """

    about: Mapping[str, Any]
    tensors: Mapping[str, tuple[int, ...]]
    places: Mapping[str, Place]
    list_begin: int
    list_end: int

    @property
    def alignment(self) -> int:
        """Tensors, and the first of them in the file, begin at multiples of so many bytes."""
        return self.about.get("general.alignment") or _ALIGNMENT

    @property
    def is_adapter(self) -> bool:
        """Whether the file holds a LoRA adapter instead of a model."""
        return self.about.get("general.type") == "adapter"

    @property
    def trained_context(self) -> int | None:
        """Tokens that the model was trained to see at once, where the file tells it."""
        return self._number("context_length")

    @property
    def cache_bytes(self) -> int:
        """Memory that the keys and values of one token take [bytes]; 0 where the file does not tell."""
        layers, heads, width = (self._number(n) for n in ("block_count", "attention.head_count", "embedding_length"))
        if layers is None or not heads or width is None:
            return 0
        key = self._number("attention.key_length") or width // heads
        value = self._number("attention.value_length") or width // heads
        return layers * (self._number("attention.head_count_kv") or heads) * (key + value) * _CACHE_BYTES

    def _number(self, name: str) -> int | None:
        value = self.about.get(f"{self.about.get('general.architecture')}.{name}")
        return value if isinstance(value, int) else None


def read_head(path: Path) -> Head:
    """Read the head of a GGUF file.

    Raises:
        InputError: for field `model`: there is no such file, or it is none of this kind.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _Reader(data).head()
    except OSError as error:
        raise InputError("model", str(path), f"a readable file ({error.strerror})") from None
    except (ValueError, struct.error):
        raise InputError("model", str(path), "a GGUF file of version 2 or 3") from None


class _Reader:
    """Goes through a file from its beginning; ValueError or struct.error where it is not what it should be."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self._at = 0

    def head(self) -> Head:
        """The whole head."""
        if self._take(4) != b"GGUF" or self._one("I") not in (2, 3):
            raise ValueError
        n_tensors, n_values = self._one("Q"), self._one("Q")
        about: dict[str, Any] = {}
        for _ in range(n_values):
            name = self._text()
            value = self._value(self._one("I"))
            if value is not None:
                about[name] = value
        begin = self._at
        tensors: dict[str, tuple[int, ...]] = {}
        places: dict[str, Place] = {}
        for _ in range(n_tensors):
            name, dims = self._text(), self._one("I")
            if dims > _MAX_DIMS:
                raise ValueError
            tensors[name] = tuple(self._one("Q") for _ in range(dims))
            places[name] = Place(self._one("I"), self._one("Q"))
        return Head(about=about, tensors=tensors, places=places, list_begin=begin, list_end=self._at)

    def _value(self, kind: int) -> Any:
        """One value; of a list only its end is looked for."""
        if kind == _STRING:
            return self._text()
        if kind != _ARRAY:
            return self._one(_SCALARS.get(kind, ""))
        inner, count = self._one("I"), self._one("Q")
        if inner in _SCALARS:
            self._take(count * struct.calcsize(_SCALARS[inner]))
        elif inner == _STRING:
            for _ in range(count):
                self._take(self._one("Q"))
        else:
            raise ValueError
        return None

    def _one(self, form: str) -> Any:
        if not form:
            raise ValueError
        (value,) = struct.unpack("<" + form, self._take(struct.calcsize("<" + form)))
        return value

    def _text(self) -> str:
        return self._take(self._one("Q")).decode("utf-8", "replace")

    def _take(self, count: int) -> bytes:
        if count > len(self._data) - self._at:
            raise ValueError
        self._at += count
        return self._data[self._at - count : self._at]
