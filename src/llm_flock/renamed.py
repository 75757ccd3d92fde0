"""Old names of flags, settings, labels and record fields. They work for one more version, with a warning."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from typing import Any, cast

from llm_flock.errors import InputError

logger = logging.getLogger(__name__)

FIELDS: Mapping[str, str] = {"ticks": "comm_rounds"}
"""Settings, in configuration files, Python calls and as flags (`--ticks`): old name to new name."""

VALUES: Mapping[str, Mapping[str, str]] = {
    "consensus": {"pedigree": "provenance"},
    "gaps": {"remake": "replan"},
}
"""Values of settings, by setting: old name to new name."""

RECORD_FIELDS: Mapping[str, Mapping[str, tuple[str, ...]]] = {"/protocol": {"comm_round": ("tick",)}}
"""Fields of recorded messages, by channel: new name to old names. Newer records have the new names only."""


ORIGINS: Mapping[str, str] = {"fallback": "geometry"}
"""Origins of waypoints in records: old name to new name."""


def current_origins(origins: list[str]) -> list[str]:
    """Origins of waypoints under their current names. Call on what an older version has recorded."""
    return [ORIGINS.get(origin, origin) for origin in origins]


def current(settings: Mapping[str, Any], *, warn: bool = True) -> dict[str, Any]:
    """Settings under their current names. Call on all settings from outside; warns once of each old name.

    Raises:
        InputError: a setting is given under both names.
    """
    found: dict[str, Any] = {}
    for name, value in settings.items():
        field = FIELDS.get(name, name)
        if field != name and settings.get(field) is not None:
            raise InputError(name, value, says=f"cannot be given together with {field}, its present name")
        new = VALUES.get(field, {}).get(value, value) if isinstance(value, str) else value
        if warn and field != name:
            _warn(name, field)
        if warn and new is not value:
            _warn(f"{field} = {value}", new)
        found[field] = new
    return found


def current_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """A stored configuration under current names, section by section. Call on what an older version has written."""
    return {
        name: current(cast("Mapping[str, Any]", section), warn=False) if isinstance(section, Mapping) else section
        for name, section in config.items()
    }


def current_label(label: str) -> str:
    """The label of a cell with current names. Call before labels of different versions are compared or shown."""
    return " ".join(map(_current_word, label.split(" ")))


def _current_word(word: str) -> str:
    name, equals, value = word.partition("=")
    if equals:
        return "=".join(*current({name: value}, warn=False).items())
    return VALUES["consensus"].get(word, word)


@cache
def _warn(old: str, new: str) -> None:
    logger.warning("%s is now called %s; the old name will go with the next version", old, new)


def former(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings under their old names. Call where a hash of settings must not change with a name."""
    fields = {new: old for old, new in FIELDS.items()}
    values = {field: {new: old for old, new in names.items()} for field, names in VALUES.items()}
    return {
        fields.get(name, name): values.get(name, {}).get(value, value) if isinstance(value, str) else value
        for name, value in settings.items()
    }


def current_flag(token: str) -> str:
    """A flag under its current name. Call on each token of a command line; logs a warning for an old name."""
    name, equals, value = token.partition("=")
    field = FIELDS.get(name.removeprefix("--").replace("-", "_")) if name.startswith("--") else None
    if field is None:
        return token
    new = "--" + field.replace("_", "-")
    _warn(name, new)
    return new + equals + value
