"""Hostile words in every text of a value, by its types: a new field of a record or a result is covered by itself."""

from __future__ import annotations

from collections.abc import Mapping
from types import UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

import msgspec
from pydantic import BaseModel

WORDS = (
    "<xss-mark></xss-mark><script>broken=1</script><img src=//elsewhere.invalid/i onerror=broken=2>"
    "<svg onload=broken=3><a href=javascript:broken=4>a</a> [a](javascript:broken=5) ![i](//elsewhere.invalid/m) "
    "\" onmouseover=broken=6 x=' autofocus onfocus=broken=7 --><iframe src=javascript:parent.broken=8></iframe> "
    "`<img src=x onerror=broken=9>` ``<xss-mark>`` </script><script>broken=10</script> ]]> {{ 7*7 }} {% raw %} "
    "${broken=11} $\\frac$ </style><style>*{background:url(//elsewhere.invalid/c)}</style> \\u003cscript> | "
    "</title></textarea></pre></svg></text> <base href=//elsewhere.invalid/> <meta http-equiv=refresh content=0> "
    "\u2028\u2029\x1b]8;;http://elsewhere.invalid/\x07\x1b[2J\u202eturned"
)
"""Would run, load, or leave an element `xss-mark` wherever text is taken for anything else."""


def fields_of(kind: type) -> dict[str, Any] | None:
    """The types of the fields of a class that holds values; None for any other type."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return {name: field.annotation for name, field in kind.model_fields.items()}
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return get_type_hints(kind)
    return None


def hostile(kind: Any, old: Any = None, words: str = WORDS) -> Any:
    """Plain data of a type, with words wherever it may hold text; numbers and lengths are those of an old value."""
    if get_origin(kind) is Annotated:
        return hostile(get_args(kind)[0], old, words)
    if get_origin(kind) in (Union, UnionType):
        return hostile(next(one for one in get_args(kind) if one is not type(None)), old, words)
    if kind is str:
        return words
    if kind is Any:
        return _free(old, words)
    if (fields := fields_of(kind)) is not None:
        before = cast("Mapping[str, Any]", old if isinstance(old, Mapping) else {})
        return {
            name: found
            for name, one in fields.items()
            if (found := hostile(one, before.get(name), words)) is not None or name in before
        }
    match get_origin(kind):
        case origin if origin in (list, tuple):
            inner = get_args(kind)[0]
            return [one if one is None else hostile(inner, one, words) for one in old or ()]
        case origin if isinstance(origin, type) and issubclass(origin, Mapping):
            inner = get_args(kind)[1]
            more = {} if inner not in (str, Any) else {words: words}
            return {**more, **{name: hostile(inner, one, words) for name, one in (old or {}).items()}}
        case _:
            return old


def _free(old: Any, words: str) -> Any:
    """Free values: all texts in them."""
    if isinstance(old, str):
        return words
    if isinstance(old, Mapping):
        return {name: _free(one, words) for name, one in cast("Mapping[str, Any]", old).items()}
    if isinstance(old, list | tuple):
        return [_free(one, words) for one in cast("list[Any]", old)]
    return old
