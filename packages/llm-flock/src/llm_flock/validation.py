"""Turns pydantic's errors into sentences of this package, which name the field and the expected value."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, cast, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from llm_flock.errors import FieldError, InputError, unknown

Model = TypeVar("Model", bound=BaseModel)

_EXPECTED: Mapping[str, str] = {
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "missing": "more numbers",
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length} of them",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
    "string_pattern_mismatch": "text of the form {pattern}",
    "string_type": "text",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": f"a whole number less than {2**63}",
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
"""The expected value by pydantic's type of error. Other types keep pydantic's text."""


def checked(model: type[Model], values: object, within: str = "") -> Model:
    """A model of these values; raises as `input_error` says."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise input_error(error, model, within) from None


def input_error(error: ValidationError, model: type[BaseModel], within: str = "") -> InputError:
    """The first error of a validation by `model` as an InputError.

    The field is named without its section, as flags and this package's own checks name it. An index in it is kept:
    `center.1`. With `within`, the place of the model in a file, it is named in full.
    """
    first = error.errors(include_url=False)[0]
    kind, value, context = first["type"], first.get("input"), first.get("ctx", {})
    if kind in ("extra_forbidden", "missing") and isinstance(first["loc"][-1], str):
        return _field_error(first["loc"], model, within, missing=kind == "missing")
    place = _resolve(first["loc"], model)[0]
    field = _place_text([within, *place] if within else _flat(place)) or "value"
    if kind == "literal_error" and isinstance(value, str):
        return InputError(field, value, says=unknown("choice", value, re.findall("'([^']*)'", context["expected"])))
    if kind == "string_pattern_mismatch" and (form := _form(first["loc"], model)) is not None:
        return InputError(field, value, form)
    if kind in _EXPECTED:
        return InputError(field, value, _EXPECTED[kind].format(**context))
    return InputError(field, value, says=first["msg"])


def _form(loc: Sequence[int | str], model: type[BaseModel]) -> str | None:
    """The form of a field's text, as its definition describes it (`expected`); None if it does not."""
    *where, name = loc
    info = fields_of(_resolve(where, model)[1]).get(str(name))
    return None if info is None else extra(info, "expected")


def _field_error(loc: Sequence[int | str], model: type[BaseModel], within: str, *, missing: bool) -> FieldError:
    """The error of a missing or unknown field."""
    where, kind = _resolve(loc[:-1], model)
    name, fields = str(loc[-1]), fields_of(kind)
    in_list = any(isinstance(part, int) for part in where)
    table = _place_text([*filter(None, [within]), *where])
    there = f" in {_place_text(_flat(where))}" if in_list and not within else f" in [{table}]" if table else ""
    field = _place_text(_flat([*where, name]))
    if missing:
        section = not there and _is_table(fields[name].annotation)
        return FieldError(
            field, says=f"section [{name}] is missing" if section else f"field {name!r} is missing{there}"
        )
    if not where and all(_is_table(info.annotation) for info in fields.values()):
        return unknown_section(name, model)
    home = next((section for section, info in model.model_fields.items() if name in fields_of(info.annotation)), None)
    if home is not None and home != table:
        return FieldError(field, says=f"field {name!r} belongs in [{home}], not{there}")
    return FieldError(field, says=unknown(f"field {name!r}{there}", name, fields))


def _flat(place: list[int | str]) -> list[int | str]:
    """A place without the names of sections."""
    while len(place) > 1 and isinstance(place[0], str) and isinstance(place[1], str):
        place = place[1:]
    return place


def unknown_section(name: str, model: type[BaseModel]) -> FieldError:
    """The error of a section that `model`, made of sections, does not have; or of a field outside its section."""
    for section, info in model.model_fields.items():
        if name in fields_of(info.annotation):
            return FieldError(name, says=f"field {name!r} belongs in [{section}], below that line")
    return FieldError(name, says=unknown(f"section [{name}]", name, model.model_fields))


def fields_of(annotation: Any) -> Mapping[str, FieldInfo]:
    """The fields of the model that a type is, or holds, by the name that a file gives them; none for other types."""
    model = _model_in(annotation)
    return {} if model is None else {info.alias or name: info for name, info in model.model_fields.items()}


def extra(info: FieldInfo, key: str) -> str | None:
    """A text that the definition of a field has in its `json_schema_extra`: `expected`, or the name of its `flag`."""
    extras: object = info.json_schema_extra
    text = cast("dict[str, object]", extras).get(key) if isinstance(extras, dict) else None
    return text if isinstance(text, str) else None


def _resolve(loc: Sequence[int | str], model: type[BaseModel]) -> tuple[list[int | str], Any]:
    """The part of a place that names fields, keys and indices, without pydantic's names of alternatives; its type."""
    place: list[int | str] = []
    kind: Any = model
    for name in loc:
        fields = fields_of(kind)
        if get_origin(kind) is dict:
            kind = get_args(kind)[1]
        elif isinstance(name, str) and name in fields:
            kind = fields[name].annotation
        elif isinstance(name, str):
            continue
        place.append(name)
    return place, kind


def _place_text(place: Sequence[int | str]) -> str:
    """A place as text. A name may come from a message or a file, with any letters."""
    return ".".join(name if name.isprintable() else ascii(name) for name in map(str, place))


def _is_table(annotation: Any) -> bool:
    return bool(fields_of(annotation)) or get_origin(annotation) is dict


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model that a type is, or holds: that of `tuple[Change, ...]` is Change."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := _model_in(part)) is not None), None)
