"""Values of every kind that a type allows, made from the type itself: msgspec structs, pydantic models, plain hints.

`legal(RobotReport)` gives a strategy. A field that is added is covered without a change here. Numbers are often at
their bounds, texts often at their longest, and names of dictionaries often those that readers look for.
"""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from llm_flock.bounds import DEEPEST
from llm_flock.errors import FlockError
from llm_flock.mission import Mission
from llm_flock.record._schema import _DETAILS, MissionInfo, State

Strategy = st.SearchStrategy[Any]

HUGE = 2**63 - 1  # for integers without a bound of their own: what MessagePack and JSON readers hold
FAR = 1e300  # likewise for numbers

WORDS = (*_DETAILS, "", "x", "\x1b[2J", "\u202e", "\ufeff", "\u3164", "</script><b>", "__proto__", "../..", "nan")
"""Texts that mean something to a reader, a terminal or a page."""

texts = st.sampled_from(WORDS) | st.text(max_size=40)


def _nested(inner: Strategy) -> Strategy:
    return st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3)


def _deep(depth: int) -> Any:
    value: Any = 0
    for number in range(depth):
        value = {"in": value} if number % 2 else [value]
    return value


scalars: Strategy = st.none() | st.booleans() | st.integers(-HUGE, HUGE) | st.floats(-FAR, FAR, allow_nan=False) | texts
plain: Strategy = st.recursive(scalars, _nested, max_leaves=8) | st.sampled_from(
    [_deep(DEEPEST - 2), _deep(DEEPEST // 2), "x" * 5000, [0] * 200]
)
"""Values that JSON holds."""


class _Bounds:
    """What the metadata of a hint allow: those of msgspec, annotated_types and pydantic have the same names."""

    def __init__(self, metadata: Iterable[Any]) -> None:
        self._all = [*_flat(metadata)]

    def get(self, name: str, default: Any = None) -> Any:
        found = [value for one in self._all if (value := getattr(one, name, None)) is not None]
        return found[-1] if found else default

    def number(self, whole: bool, default: float) -> tuple[Any, Any]:
        """The smallest and the largest number that is allowed."""
        low, high, step = self.get("ge"), self.get("le"), 1 if whole else None
        if (above := self.get("gt")) is not None:
            low = above + 1 if step else _next_to(above, 1.0)
        if (below := self.get("lt")) is not None:
            high = below - 1 if step else _next_to(below, -1.0)
        kind = int if whole else float
        return kind(-default if low is None else low), kind(default if high is None else high)


def _next_to(value: float, sign: float) -> float:
    """A number next to an open bound."""
    return value + sign * max(1e-9, abs(value) * 1e-9)


def _flat(metadata: Iterable[Any]) -> Iterable[Any]:
    for one in metadata:
        yield one
        if isinstance(one, FieldInfo):
            yield from _flat(one.metadata)


def _numbers(bounds: _Bounds, whole: bool) -> Strategy:
    low, high = bounds.number(whole, HUGE if whole else FAR)
    edges = [edge for edge in (low, high, 0, 1, -1, -0.0) if low <= edge <= high]
    some = st.integers(low, high) if whole else st.floats(low, high, allow_nan=False)
    return some | st.sampled_from([int(edge) if whole else float(edge) for edge in edges])


def _texts(bounds: _Bounds) -> Strategy:
    if (pattern := bounds.get("pattern")) is not None:
        return st.from_regex(pattern if isinstance(pattern, re.Pattern) else re.compile(pattern))
    low, high = bounds.get("min_length", 0), bounds.get("max_length", 5000)
    longest = st.sampled_from(["x", "\x00", "\u202e", "\U0001f6f8"]).map(lambda letter: letter * min(high, 5000))
    return texts.filter(lambda text: low <= len(text) <= high) | longest


def _sizes(bounds: _Bounds) -> dict[str, Any]:
    low, high = bounds.get("min_length", 0), bounds.get("max_length", 4)
    return {"min_size": low, "max_size": min(high, max(4, low))}


def _many(item: Any, bounds: _Bounds) -> Strategy:
    """Lists of few items, and of one item again and again, up to 300."""
    sizes, most = _sizes(bounds), min(bounds.get("max_length", 300), 300)
    few = st.lists(legal(item), **sizes)
    return few if most <= sizes["max_size"] else few | few.filter(bool).map(lambda some: (some * most)[:most])


def _struct(kind: type[msgspec.Struct]) -> Strategy:
    hints = typing.get_type_hints(kind, include_extras=True)
    return st.fixed_dictionaries({name: legal(hints[name]) for name in kind.__struct_fields__}).flatmap(
        lambda values: _built(lambda: kind(**values))
    )


def _model(kind: type[BaseModel]) -> Strategy:
    """Models as their own check allows them: fields may be checked together."""
    if kind is State:
        return _states()
    if kind is MissionInfo:
        return _missions().map(lambda mission: MissionInfo(version=0, round=0, mission=mission.model_dump(mode="json")))
    needed = {name: legal(_hint(info)) for name, info in kind.model_fields.items() if info.is_required()}
    others = {name: legal(_hint(info)) for name, info in kind.model_fields.items() if not info.is_required()}
    return st.fixed_dictionaries(needed, optional=others).map(lambda values: _checked(kind, values)).filter(bool)


def _states() -> Strategy:
    """States whose lists have an item for each robot, and whose points have as many coordinates."""

    def of(team: tuple[int, int]) -> Strategy:
        sizes: dict[str, Any] = {"min_size": team[0], "max_size": team[0]}
        point = st.lists(
            st.floats(-1e12, 1e12) | st.sampled_from([-1e12, 0.0, 1e12]), min_size=team[1], max_size=team[1]
        )
        lists: dict[str, Strategy] = {
            name: st.lists(legal(get_args(_plain_hint(info.annotation))[0]), **sizes)
            for name, info in State.model_fields.items()
            if name != "round"
        }
        lists |= {"positions": st.lists(point, **sizes)}
        lists |= {name: st.lists(st.none() | point, **sizes) for name in ("goals", "waypoints")}
        return st.fixed_dictionaries({"round": legal(_hint(State.model_fields["round"])), **lists})

    teams = st.tuples(st.integers(1, 4), st.integers(2, 3))
    return teams.flatmap(of).map(lambda values: State(**values))


def _plain_hint(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _missions() -> Strategy:
    """Missions: one of a few, with some fields replaced by what their types allow, as long as it stays one."""
    bases = [
        Mission(shape="circle", n_robots=3),
        Mission(shape="square", n_robots=4),
        Mission(shape="line", n_robots=1),
    ]
    changes = {name: legal(_hint(info)) for name, info in Mission.model_fields.items()}

    def changed(base: Mission, name: str, values: Any) -> Strategy:
        found = _checked(Mission, {**base.model_dump(), name: values})
        return st.just(found or base)

    return st.tuples(st.sampled_from(bases), st.sampled_from(sorted(changes))).flatmap(
        lambda two: changes[two[1]].flatmap(lambda value: changed(two[0], two[1], value))
    )


def _hint(info: FieldInfo) -> Any:
    return Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation


def _checked(kind: type[BaseModel], values: Mapping[str, Any]) -> BaseModel | None:
    try:
        return kind(**values)
    except (ValidationError, FlockError):
        return None


def _built(make: Callable[[], Any]) -> Strategy:
    try:
        return st.just(make())
    except (TypeError, ValueError):
        return st.nothing()


def legal(hint: Any, metadata: Sequence[Any] = (), **fields: Strategy) -> Strategy:
    """A strategy of values that a type allows; `fields` replace those of a struct or model by name."""
    origin, args, bounds = get_origin(hint), get_args(hint), _Bounds(metadata)
    if fields:
        return st.tuples(legal(hint), st.fixed_dictionaries(fields)).map(lambda two: _replaced(*two))
    if origin is Annotated:
        return legal(args[0], (*args[1:], *metadata))
    if hint is Any or hint is object:
        return plain
    if origin is Literal:
        return st.sampled_from(args)
    if origin in (Union, types.UnionType):
        return st.one_of(*[legal(arg, () if arg is type(None) else metadata) for arg in args])
    if origin in (tuple,) and args[-1] is not Ellipsis:
        return st.tuples(*map(legal, args))
    if origin in (tuple, list, set, frozenset):
        return _many(args[0], bounds).map(origin)
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return _many(args[0], bounds)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return st.dictionaries(legal(args[0]), legal(args[1]), **_sizes(bounds))
    if hint in (None, type(None)):
        return st.none()
    if hint is bool:
        return st.booleans()
    if hint is str:
        return _texts(bounds)
    if hint is bytes:
        return st.binary(**_sizes(bounds))
    if hint in (int, float):
        return _numbers(bounds, hint is int)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return st.sampled_from(list(hint))
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return _struct(hint)
    if hint is Mission:
        return _missions()
    if isinstance(hint, type) and issubclass(hint, BaseModel):
        return _model(hint)
    raise NotImplementedError(f"no values of {hint!r}: say here how they are made")


def _replaced(value: Any, changes: Mapping[str, Any]) -> Any:
    if isinstance(value, BaseModel):
        return value.model_copy(update=dict(changes))
    return msgspec.structs.replace(value, **changes)
