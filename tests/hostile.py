"""Hostile but legal values, made from the types that read them: a new field is covered without a change here.

Structs are taken apart by msgspec, models of pydantic by their JSON schema. Numbers lean to their bounds, texts to what
a file, a terminal, a page or an importer might act on. `like` is a good value: most of it is kept, so that checks
across fields are passed and what stands behind them is reached.
"""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

import msgspec.inspect as wire
from effort import EFFORT
from mangled import changed_bytes
from pydantic import BaseModel

BAIT = "hostile_bait"
"""Module that nothing may import, file that nothing may open, and folder that nothing may look into."""

LURES = (
    "", "0", "-1", "nan", "x" * 63, "x" * 64, "x" * 5_000, "\u1112" * 700, "None", "..", ".", "a/b", "a\\b", "C:",
    f"/{BAIT}/file", f"../{BAIT}/file", f"~/{BAIT}", f"points:/{BAIT}/file", f"points:../{BAIT}/file", "/dev/zero",
    f"{BAIT}:Class", f"{BAIT}.a:b", "this:d", "antigravity:x", "os:system", "subprocess:Popen", f"local:/{BAIT}/file",
    f"replay:/{BAIT}/file", f"replay:../{BAIT}/file", "openai:gpt-4o", "ollama:x", "simulated:ideal", "geometry",
    "http://127.0.0.1:9/v1", "https://bait.invalid/v1", f"file:///{BAIT}/file", "tcp/127.0.0.1:9",
    "udp://127.0.0.1:9", "radio://0/80/2M/E7E7E7E701", "0=simulated:ideal,1-2=openai:x", "0-99999999999=a",
    "polygon:5", "text:\ud55c", "star", "\0", "\x1b[2J\x1b]0;x\x07", "\r\n", "\u202e", "\u3164", "\u200b\u2066",
    "e\u0301" * 9, "\U000e0041", "\ufeff", "\x7f", "<script>alert(1)</script>", "\"'><img src=x onerror=alert(1)>",
    "[x](javascript:alert(1))", "=cmd|' /C calc'!A0", "$(id)", "`id`", "%s%n{0.__class__}", "{{7*7}}",
    "{% include '/etc/passwd' %}", "[bold red]x[/]", "[/]", "$\\frac{$", "*" * 300, "formed", "model", "plan", "step",
    "text", "json", "none", "full", "accused",
)  # fmt: skip

WHOLE = (0, 1, -1, 2, 3, 255, 2**31, 2**53, 2**53 + 1, 2**63 - 1, -(2**63), 2**64 - 1)
REAL = (0.0, -0.0, 1.0, 0.5, -1.0, 5e-324, 1e-9, 1e6, 1e12, 1e15, 1e16, 1e300, -1.7e308)
BEYOND = (float("nan"), float("inf"), float("-inf"))
NONE = object()


def matching(pattern: str, rng: random.Random) -> str:
    """A text of a form: as short or as long as it may be, with letters from the ends of its ranges."""

    def one(operation: Any, value: Any) -> str:
        match str(operation):
            case "LITERAL":
                return chr(value)
            case "IN":
                return one(*rng.choice(value))
            case "RANGE":
                return chr(rng.choice(value))
            case "CATEGORY":
                return rng.choice("a0_\u00e9\u1112\u0660" if "WORD" in str(value) else "09")
            case "MAX_REPEAT" | "MIN_REPEAT":
                low, high, inner = value
                return "".join(several(inner) for _ in range(rng.choice((low, low + 1, min(high, low + 90)))))
            case "SUBPATTERN":
                return several(value[-1])
            case "BRANCH":
                return several(rng.choice(value[1]))
            case "AT":
                return ""
            case _:
                return rng.choice("x~\u3164")

    def several(parts: Any) -> str:
        return "".join(one(*part) for part in parts)

    return several(_parsed(pattern))


@cache
def _parsed(pattern: str) -> Any:
    return re._parser.parse(pattern)  # pyright: ignore[reportAttributeAccessIssue]


@cache
def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


@cache
def type_of(kind: Any) -> Any:
    return wire.type_info(kind)


class Hostile:
    """Draws values. `binary`: the encoding holds bytes; `beyond`: it holds NaN and infinities."""

    def __init__(self, rng: random.Random, *, binary: bool = False, beyond: bool = True) -> None:
        self.rng = rng
        self._binary = binary
        self._reals = (*REAL, *BEYOND) if beyond else REAL

    def struct(self, kind: Any, like: Any = NONE) -> Any:
        """A value of a type that msgspec knows, as plain data."""
        return self._typed(type_of(kind), like)

    def model(self, kind: type[BaseModel], like: Any = NONE) -> Any:
        """A value of a model of pydantic, as plain data."""
        return self.schema(schema_of(kind), like)

    def schema(self, schema: Mapping[str, Any], like: Any = NONE) -> Any:
        """A value of a JSON schema."""
        return self._node(schema, schema.get("$defs", {}), like, 6)

    # --- leaves -------------------------------------------------------------------------------------------------------

    def whole(self, low: float | None = None, high: float | None = None) -> int:
        rng = self.rng
        low = -(2**63) if low is None else int(low)
        high = 2**64 - 1 if high is None else int(high)
        match rng.randrange(4):
            case 0:
                return rng.choice((low, high, min(low + 1, high), max(high - 1, low)))
            case 1:
                return rng.randint(low, high)
            case _:
                return min(max(rng.choice(WHOLE), low), high)

    def real(self, low: float | None = None, high: float | None = None, like: Any = NONE) -> float | int:
        rng = self.rng
        value = rng.choice(self._reals)
        if isinstance(like, float | int) and rng.random() < 0.3:
            value = like * (1.0 + rng.choice((1e-12, -1e-6, 0.01, -0.1, -2.0)))
        if rng.random() < 0.3:
            value = rng.choice([x for x in (low, high, 0.0) if x is not None])
        if low is not None and not value >= low:
            value = low
        if high is not None and not value <= high:
            value = high
        return int(value) if value in (0, 1, 2**53) and rng.random() < 0.5 else value

    def text(self, low: int = 0, high: int | None = None, pattern: str | None = None) -> str:
        if pattern is not None:
            return matching(pattern, self.rng)
        text = self.rng.choice(LURES)
        if self.rng.random() < 0.2:
            text += self.rng.choice(LURES)
        return (text if high is None else text[:high]).ljust(low, "x")

    def free(self, depth: int = 4) -> Any:
        """Any value at all."""
        rng = self.rng
        match rng.randrange(10 if depth else 6):
            case 0:
                return self.whole()
            case 1:
                return self.real()
            case 2 | 3:
                return self.text()
            case 4:
                return rng.choice((None, True, False))
            case 5:
                return rng.choice((b"", b"\xff" * 8, b"x" * 64)) if self._binary else self.text()
            case 6:
                return self._deep()
            case 7 | 8:
                return [self.free(depth - 1) for _ in range(rng.choice((0, 1, 2, 9)))]
            case _:
                return {self.text(): self.free(depth - 1) for _ in range(rng.choice((0, 1, 3)))}

    def _deep(self) -> Any:
        value: Any = 1
        for _ in range(self.rng.choice((8, 31, 33, 200))):
            value = [value]
        return value

    def table(self, like: Any) -> dict[str, Any]:
        """A dictionary of free values; most of those of `like` are kept."""
        if not isinstance(like, Mapping) or self.rng.random() < 0.1:
            found = self.free(3)
            return found if isinstance(found, dict) else {self.text(): found}
        changed = dict(like)
        for _ in range(self.rng.choice((0, 1, 1, 2))):
            name = self.rng.choice([*changed, self.text()])
            old = changed.get(name, NONE)
            changed[name] = self.table(old) if isinstance(old, Mapping) and old else self.free(3)
        return changed

    # --- what both kinds of types have in common ----------------------------------------------------------------------

    def _count(self, low: int | None, high: int | None) -> int:
        low = low or 0
        high = 2_000 if high is None else high
        rare = high if self.rng.random() < 0.02 else low
        return min(max(self.rng.choice((low, low, low + 1, 2, 3, 4, rare)), low), high)

    def _items(self, item: Callable[[Any], Any], low: int | None, high: int | None, like: Any) -> list[Any]:
        if isinstance(like, list | tuple) and self.rng.random() < 0.9:
            items = list(like)
            for _ in range(self.rng.choice((1, 1, 2)) if items else 0):
                at = self.rng.randrange(len(items))
                items[at] = item(items[at])
            return items
        one = item(NONE)
        count = self._count(low, high)
        return [one] * count if count > 50 else [item(NONE) for _ in range(count)]

    def _fields(self, fields: list[tuple[str, bool, Callable[[Any], Any]]], like: Any) -> dict[str, Any]:
        """Some fields of a good value are changed, or all; those that it lacks are drawn, optional ones at times."""
        known: Mapping[str, Any] = like if isinstance(like, Mapping) else {}
        share = self.rng.choice((0.0, 1.0 / max(1, len(fields)), 1.0 / max(1, len(fields)), 0.2, 1.0))
        found: dict[str, Any] = {}
        for name, required, draw in fields:
            if name in known and self.rng.random() >= share:
                found[name] = known[name]
            elif name in known or required or self.rng.random() < (0.1 if known else 0.5):
                found[name] = draw(known.get(name, NONE))
        if known and share == 0.0:  # exactly one
            name, _, draw = self.rng.choice(fields)
            found[name] = draw(known.get(name, NONE))
        return found

    # --- msgspec ------------------------------------------------------------------------------------------------------

    def _typed(self, kind: Any, like: Any = NONE) -> Any:
        match kind:
            case wire.StructType() | wire.DataclassType():
                return self._struct(kind, like)
            case wire.IntType():
                low = kind.ge if kind.gt is None else kind.gt + 1
                return self.whole(low, kind.le if kind.lt is None else kind.lt - 1)
            case wire.FloatType():
                return self.real(kind.ge if kind.gt is None else kind.gt, kind.le if kind.lt is None else kind.lt, like)
            case wire.StrType():
                return self.text(kind.min_length or 0, kind.max_length, kind.pattern)
            case wire.BytesType():
                high = 64 if kind.max_length is None else kind.max_length
                return self.rng.randbytes(self.rng.choice((kind.min_length or 0, high)))
            case wire.BoolType():
                return self.rng.random() < 0.5
            case wire.NoneType():
                return None
            case wire.UnionType():
                known = [one for one in kind.types if not isinstance(one, wire.NoneType)]
                chosen = self.rng.choice(kind.types if like is NONE or self.rng.random() < 0.2 else known)
                return self._typed(chosen, like)
            case wire.VarTupleType() | wire.ListType():
                return self._items(lambda old: self._typed(kind.item_type, old), kind.min_length, kind.max_length, like)
            case wire.TupleType():
                known = like if isinstance(like, list | tuple) else ()
                return [self._typed(t, known[k] if k < len(known) else NONE) for k, t in enumerate(kind.item_types)]
            case wire.DictType():
                if isinstance(kind.value_type, wire.AnyType):
                    return self.table(like)
                old = list(like.items()) if isinstance(like, Mapping) else []
                pairs = self._items(
                    lambda _: (self._typed(kind.key_type), self._typed(kind.value_type)), 0, kind.max_length, old
                )
                return dict(pairs)
            case wire.LiteralType():
                return self.rng.choice(kind.values)
            case wire.CustomType() if isinstance(kind.cls, type) and issubclass(kind.cls, BaseModel):
                known = json.loads(like) if isinstance(like, bytes) else NONE  # models travel as JSON
                return json.dumps(Hostile(self.rng).model(kind.cls, known)).encode()
            case _:
                return self.free()

    def _struct(self, kind: Any, like: Any) -> Any:
        fields = [
            (f.encode_name, f.required, lambda old, f=f: self._typed(f.type, old))
            for f in kind.fields
            if f.type != wire.CustomType(object)  # never sent
        ]
        if not getattr(kind, "array_like", False):
            return self._fields(fields, like)
        names = [name for name, _, _ in fields]
        known = dict(zip(names, like, strict=False)) if isinstance(like, list | tuple) else NONE
        found = self._fields([(name, True, draw) for name, _, draw in fields], known)
        # Behind the fields of a good value, none is needed: most of those would be rejected for being there.
        row = [found[name] for name in names]
        if isinstance(like, list | tuple) and self.rng.random() < 0.8:
            del row[len(like) :]
        tag = [] if kind.tag is None else [kind.tag]
        return tag + row

    # --- JSON schema --------------------------------------------------------------------------------------------------

    def _node(self, node: Mapping[str, Any], defs: Mapping[str, Any], like: Any, depth: int) -> Any:
        rng = self.rng
        if "$ref" in node:
            return self._node(defs[node["$ref"].rpartition("/")[2]], defs, like, depth - 1)
        if "const" in node or "enum" in node:
            return rng.choice(node.get("enum") or [node["const"]])
        for name in ("anyOf", "oneOf"):
            if name in node:
                kinds = node[name]
                if like is not NONE and like is not None and rng.random() < 0.8:
                    kinds = [one for one in kinds if one.get("type") != "null"]
                return self._node(rng.choice(kinds), defs, like, depth)
        if "allOf" in node:
            return self._node(node["allOf"][0], defs, like, depth)
        match node.get("type"):
            case "integer":
                low = node.get("minimum", node.get("exclusiveMinimum", -(2**63) - 1) + 1)
                high = node.get("maximum", node.get("exclusiveMaximum", 2**64) - 1)
                return self.whole(low, high)
            case "number":
                low, high = node.get("minimum"), node.get("maximum")
                if "exclusiveMinimum" in node:
                    low = math.nextafter(node["exclusiveMinimum"], math.inf)
                if "exclusiveMaximum" in node:
                    high = math.nextafter(node["exclusiveMaximum"], -math.inf)
                return self.real(low, high, like)
            case "string":
                return self.text(node.get("minLength", 0), node.get("maxLength"), node.get("pattern"))
            case "boolean":
                return rng.random() < 0.5
            case "null":
                return None
            case "array":
                parts = node.get("prefixItems")
                if parts is not None:
                    known = like if isinstance(like, list | tuple) else ()
                    return [
                        self._node(one, defs, known[k] if k < len(known) else NONE, depth - 1)
                        for k, one in enumerate(parts)
                    ]
                item = node.get("items", {})
                return self._items(
                    lambda old: self._node(item, defs, old, depth - 1),
                    node.get("minItems"),
                    node.get("maxItems") if depth > 0 else 0,
                    like,
                )
            case "object" if node.get("properties"):
                required = node.get("required", ())
                fields = [
                    (name, name in required, lambda old, one=one: self._node(one, defs, old, depth - 1))
                    for name, one in node["properties"].items()
                ]
                return self._fields(fields, like)
            case "object" if isinstance(values := node.get("additionalProperties"), dict):
                known = dict(like) if isinstance(like, Mapping) else {}
                for _ in range(self.rng.choice((0, 1, 2))):
                    name = self.rng.choice([*known, self.text()])
                    known[name] = self._node(values, defs, known.get(name, NONE), depth - 1)
                return known
            case "object":
                return self.table(like)
            case _:
                return self.free(2)


# --- running it -------------------------------------------------------------------------------------------------------


def seeds(kind: str, number: int, part: int = 0, parts: int = 1) -> Iterator[str]:
    """A part's share of as many seeds as `number` and LLM_FLOCK_EFFORT say."""
    for case in range(part, max(1, round(number * EFFORT)), parts):
        yield f"{kind}-{case}"


@contextmanager
def drawn(seed: str) -> Iterator[random.Random]:
    """A source of chance; what fails with it is told with its seed."""
    try:
        yield random.Random(seed)
    except BaseException as error:
        error.add_note(f"seed: {seed}")
        raise


def damaged(payload: bytes, rng: random.Random) -> bytes:
    """The same, but one in ten with bytes changed, lost or added."""
    return changed_bytes(payload, rng) if rng.random() < 0.1 else payload


def toml(value: Any) -> str:
    """A table as a TOML file; what is None is left out."""
    return "".join(f"{_quoted(name)} = {_toml(one)}\n" for name, one in value.items() if one is not None)


def _toml(value: Any) -> str:
    match value:
        case Mapping():
            pairs = (f"{_quoted(str(name))} = {_toml(one)}" for name, one in value.items() if one is not None)
            return "{" + ", ".join(pairs) + "}"
        case list() | tuple():
            return "[" + ", ".join(_toml(one) for one in value if one is not None) + "]"
        case str():
            return _quoted(value)
        case bool():
            return str(value).lower()
        case _:
            return repr(value)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
