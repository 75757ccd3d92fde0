"""The same weights in a format that a processor reads faster, made once and kept in the user's cache.

Q4_1 (ggml: blocks of 32 numbers, `scale * q + least` with q of four bits) is compact and slow to compute with: as Q8_0
(`scale * q` with q of eight bits) questions are read about 1.7 times as fast. The numbers stay what they
were up to half a 127th of the largest of their block, which is a small part of what four bits lost before.
"""

from __future__ import annotations

import logging
import math
import os
import struct
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from llm_flock.llm.local.gguf import Head, Place

logger = logging.getLogger(__name__)

Bytes: TypeAlias = np.ndarray[Any, np.dtype[np.uint8]]

F32, Q4_1, Q8_0 = 0, 3, 8
"""Formats by llama.cpp's numbers."""

BLOCK = 32
"""Numbers of a block."""

BLOCK_BYTES: Mapping[int, int] = {F32: 4 * BLOCK, Q4_1: 2 + 2 + BLOCK // 2, Q8_0: 2 + BLOCK}
"""Bytes of so many numbers in each format; files with others are left as they are."""


def cache_folder() -> Path:
    """Where this user's programs keep what they can make again (XDG base directories)."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(given) if given.startswith("/") else Path.home() / ".cache") / "llm-flock"


def can_recast(head: Head) -> bool:
    """Whether a file has matrices in the slow format, and nothing that is unknown here."""
    formats = {place.format for place in head.places.values()}
    return Q4_1 in formats and formats <= BLOCK_BYTES.keys()


def recast(source: Path, head: Head, digest: str) -> Path:
    """The file with its Q4_1 tensors as Q8_0, made if it is not in the cache yet; the source where that cannot be.

    Args:
        source: GGUF file.
        head: of that file.
        digest: SHA-256 of it, hexadecimal: another file of the same name has a place of its own.
    """
    if not can_recast(head):
        return source
    places, size = _new_places(head)
    try:
        target = cache_folder() / f"{source.stem}-as-Q8_0-{digest[:16]}.gguf"
        if not os.access(target, os.R_OK) or target.stat().st_size != size:
            _write(source, head, places, target)
    except (OSError, RuntimeError, ValueError) as error:  # there is no home, or the file ends too early
        logger.warning("%s is read as it is, slowly: its faster form cannot be kept (%s)", source.name, error)
        return source
    return target


def q8_from_q4(blocks: Bytes) -> Bytes:
    """Blocks of Q4_1, shape (n, 20), as Q8_0, shape (n, 34)."""
    ends = np.ascontiguousarray(blocks[:, :4]).view("<f2").astype(np.float32)
    packed = blocks[:, 4:]
    # The low halves of the bytes are the first sixteen numbers, the high halves the others.
    numbers = np.concatenate((packed & 15, packed >> 4), axis=1) * ends[:, :1] + ends[:, 1:]
    scale = np.abs(numbers).max(axis=1, keepdims=True) / 127
    whole = np.rint(numbers / np.where(scale > 0, scale, 1)).astype(np.int8)
    return np.concatenate((scale.astype("<f2").view(np.uint8), whole.view(np.uint8)), axis=1)


def _bytes_of(size: tuple[int, ...], kind: int) -> int:
    return math.prod(size) * BLOCK_BYTES[kind] // BLOCK


def _padding(count: int, alignment: int) -> int:
    return -count % alignment


def _new_places(head: Head) -> tuple[dict[str, Place], int]:
    """Where the tensors will be, and the size of the whole file [bytes]; the head keeps its length."""
    places: dict[str, Place] = {}
    at = 0
    for name, old in head.places.items():
        kind = Q8_0 if old.format == Q4_1 else old.format
        places[name] = Place(kind, at)
        at += _bytes_of(head.tensors[name], kind)
        at += _padding(at, head.alignment)
    return places, head.list_end + _padding(head.list_end, head.alignment) + at


def _write(source: Path, head: Head, places: Mapping[str, Place], target: Path) -> None:
    """Whole or not at all: other processes may do the same at the same time."""
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=target.name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines(_parts(np.memmap(source, np.uint8, "r"), head, places))
            file.flush()
            os.fsync(file.fileno())  # its name and size are trusted from now on
        Path(name).replace(target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    logger.info("%s is kept as %s", source.name, target)


def _parts(data: Bytes, head: Head, places: Mapping[str, Place]) -> Iterator[bytes]:
    """The new file from its beginning to its end."""
    yield data[: head.list_begin].tobytes()
    for name, place in places.items():
        text, size = name.encode(), head.tensors[name]
        yield struct.pack("<Q", len(text)) + text + struct.pack(f"<I{len(size)}Q", len(size), *size)
        yield struct.pack("<IQ", place.format, place.begin)
    begin = head.list_end + _padding(head.list_end, head.alignment)
    yield bytes(begin - head.list_end)
    for name, place in places.items():
        old = head.places[name]
        first = begin + old.begin
        numbers = data[first : first + _bytes_of(head.tensors[name], old.format)]
        if old.format != place.format:
            numbers = q8_from_q4(numbers.reshape(-1, BLOCK_BYTES[Q4_1]))
        yield numbers.tobytes() + bytes(_padding(numbers.size, head.alignment))
