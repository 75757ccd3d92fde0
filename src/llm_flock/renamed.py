"""Old names of flags, settings and record fields. They work for one more version, with a warning."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

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


def current(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings under their current names. Call on all settings from outside; logs a warning for each old name."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        field = FIELDS.get(name, name)
        if field != name:
            logger.warning("%s is now called %s; the old name will go with the next version", name, field)
        new = VALUES.get(field, {}).get(value, value) if isinstance(value, str) else value
        if new is not value:
            logger.warning("%s = %s is now called %s; the old name will go with the next version", field, value, new)
        found[field] = new
    return found


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
    logger.warning("%s is now called %s; the old name will go with the next version", name, new)
    return new + equals + value
