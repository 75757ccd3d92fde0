"""Rewrite weights in a format that a processor reads faster, once, into the user's cache.

Q4_1 (ggml: blocks of 32 numbers, `scale * q + least` with q of four bits) is compact but slow to compute with. As Q8_0
(`scale * q` with q of eight bits) the engine reads questions about 1.7 times as fast. Each number changes by at most
half a 127th of the largest one of its block, a small part of what four bits had already lost.
"""

from __future__ import annotations

import logging
import math
import os
import struct
import tempfile
from collections.abc import Iterator, Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from llm_flock_onboard._local.gguf import Header, Tensor

logger = logging.getLogger(__name__)

Bytes: TypeAlias = np.ndarray[Any, np.dtype[np.uint8]]

F32, Q4_1, Q8_0 = 0, 3, 8
"""Formats by llama.cpp's numbers."""

BLOCK = 32
"""Numbers of a block."""

BLOCK_BYTES: Mapping[int, int] = {F32: 4 * BLOCK, Q4_1: 2 + 2 + BLOCK // 2, Q8_0: 2 + BLOCK}
"""Bytes of a block in each format; files with other formats are left as they are."""


def cache_folder() -> Path:
    """This user's cache (XDG base directories)."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(given) if given.startswith("/") else Path.home() / ".cache") / "llm-flock"


def requantize_file(source: Path, header: Header, digest: str) -> Path:
    """The GGUF file with its Q4_1 tensors as Q8_0, written to the cache if need be.

    The SHA-256 digest (hexadecimal) tells apart files of the same name. Returns `source` itself where it has no Q4_1 or
    a format unknown here, or cannot be cached (logged).
    """
    formats = {tensor.format for tensor in header.tensors.values()}
    if Q4_1 not in formats or not formats <= BLOCK_BYTES.keys():
        return source
    size = header.data_begin + sum(_new_sizes(header))
    try:
        target = cache_folder() / f"{source.stem}-as-Q8_0-{digest[:16]}.gguf"
        if not os.access(target, os.R_OK) or target.stat().st_size != size:
            _write(source, header, target)
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


def _new(kind: int) -> int:
    return Q8_0 if kind == Q4_1 else kind


def _size(tensor: Tensor, kind: int) -> int:
    return math.prod(tensor.shape) * BLOCK_BYTES[kind] // BLOCK


def _new_sizes(header: Header) -> list[int]:
    """Bytes of each tensor in the new file, padding included."""
    sizes = (_size(tensor, _new(tensor.format)) for tensor in header.tensors.values())
    return [size + -size % header.alignment for size in sizes]


def _write(source: Path, header: Header, target: Path) -> None:
    """Write the whole file or none of it: other processes may do the same at the same time."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=target.parent, prefix=target.name, delete=False) as file:
        try:
            file.writelines(_parts(np.memmap(source, np.uint8, "r"), header))
            file.flush()
            os.fsync(file.fileno())  # name and size are trusted from now on
            Path(file.name).replace(target)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise
    logger.info("%s is kept as %s", source.name, target)


def _parts(data: Bytes, header: Header) -> Iterator[bytes]:
    """The header with new formats and offsets, then each tensor."""
    start, sizes = bytearray(data[: header.data_begin]), _new_sizes(header)
    for tensor, offset in zip(header.tensors.values(), accumulate(sizes, initial=0), strict=False):
        struct.pack_into("<IQ", start, tensor.entry, _new(tensor.format), offset)
    yield bytes(start)
    for tensor in header.tensors.values():
        first = header.data_begin + tensor.offset
        numbers = data[first : first + _size(tensor, tensor.format)]
        if tensor.format == Q4_1:
            numbers = q8_from_q4(numbers.reshape(-1, BLOCK_BYTES[Q4_1]))
        yield numbers.tobytes() + bytes(-numbers.size % header.alignment)
