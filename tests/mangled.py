"""Hostile copies of good bytes: flipped, cut, doubled and spliced, or well-formed with unexpected values."""

from __future__ import annotations

import json
import random
import resource
import time
from collections.abc import Callable
from typing import Any

import msgspec
from slowness import slowness

SLOWEST_S = 2.0
"""Longest time for one hostile input [s]."""

MAX_MIB = 200
"""Most memory that one hostile input may add to what the process has had [MiB]."""

DEEP: Any = []
for _ in range(400):
    DEEP = [DEEP]

WEIRD: list[Any] = [
    None, True, False, 0, -1, 1, 2, 255, 2**31, 2**53, 2**63 - 1, -(2**63), 2**64 - 1, 10**300, 0.0, -0.0, 0.5, -1e-300,
    1e6, 1.1e6, -1e308, float("nan"), float("inf"), -float("inf"), "", "x", "\x00", "\x1b[2J", "\u202e", "x" * 5000,
    "NaN", "0", "-1", [], {}, [[]], [[1]], [1.0, 2.0, 3.0], [float("nan")] * 2, ["a", "b"], [None] * 40, [[0.0] * 40],
    {"": 1}, {"x": {"y": {}}}, [0] * 3000, DEEP, b"", b"\xff" * 8, b"\x00" * 64,
]  # fmt: skip
"""Values of every kind that a decoder knows, and some that it may not."""


LENGTHS = (b"\xff" * 8, b"\x00" * 8, b"\x7f" + b"\xff" * 7, b"\xdd\xff\xff\xff\xff")
"""Lengths and counts that nothing has."""


def changed_bytes(data: bytes, rng: random.Random) -> bytes:
    """A copy with a few bytes changed, taken out, put in, doubled or moved, or with its end cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(6):
            case 0 if out:
                out[at % len(out)] = rng.randrange(256)
            case 1:
                out[at:at] = rng.randbytes(rng.choice((1, 4, 60)))
            case 2:
                del out[at : at + rng.choice((1, 8, 200))]
            case 3:
                out[at:at] = out[at : at + 100]
            case 4:
                out[at : at + 8] = rng.choice(
                    (b"\xff" * 8, b"\x00" * 8, b"\x7f" + b"\xff" * 7, b"\xdd\xff\xff\xff\xff")
                )
            case _:
                del out[at:]
    return bytes(out)


def changed_value(value: Any, rng: random.Random) -> Any:
    """A copy with a value of every kind somewhere inside it, something left out, or something doubled."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        items = dict(value)
        key = rng.choice(list(items))
        match rng.randrange(8):
            case 0:
                del items[key]
            case 1:
                items[rng.choice(("", "x", str(key) + "_", "\x1b"))] = rng.choice(WEIRD)
            case _:
                items[key] = changed_value(items[key], rng)
        return items
    if isinstance(value, list | tuple) and value and rng.random() < 0.85:
        rows: list[Any] = list(value)
        at = rng.randrange(len(rows))
        match rng.randrange(8):
            case 0:
                del rows[at]
            case 1:
                rows.insert(at, rng.choice((rows[at], rng.choice(WEIRD))))
            case _:
                rows[at] = changed_value(rows[at], rng)
        return rows
    return rng.choice(WEIRD)


def mangled(data: bytes, rng: random.Random, skip: int = 0) -> bytes:
    """A hostile copy of MessagePack behind `skip` bytes."""
    if rng.random() < 0.4:
        return changed_bytes(data, rng)
    try:
        value = msgspec.msgpack.decode(data[skip:])
        for _ in range(rng.choice((1, 1, 2))):
            value = changed_value(value, rng)
        return data[:skip] + msgspec.msgpack.encode(value)
    except (msgspec.MsgspecError, OverflowError, RecursionError, ValueError, TypeError):
        return changed_bytes(data, rng)


def mangled_json(data: bytes, rng: random.Random) -> bytes:
    """A hostile copy of JSON; what JSON cannot hold, Python's dialect of it (NaN) or text stands for."""
    if rng.random() < 0.3:
        return changed_bytes(data, rng)
    value = changed_value(json.loads(data), rng)
    plain: Callable[[Any], str] = repr
    return json.dumps(value, default=plain).encode()


def memory_mib() -> float:
    """The most memory that this process has had [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def tried(target: Callable[[], object], *refusals: type[Exception], within_s: float = SLOWEST_S) -> str | None:
    """Run a target; the text of its refusal, in one line, in time and memory, or None if it took what it got."""
    began, before = time.perf_counter(), memory_mib()
    says: str | None = None
    try:
        target()
    except refusals as error:
        says = str(error)
        assert says and "\n" not in says
    took = time.perf_counter() - began
    assert memory_mib() - before < MAX_MIB
    assert took < within_s or took < within_s * slowness()
    return says
