"""Reads Crazyswarm2's `crazyflies.yaml`, fileversion 3: the drones, their starts and firmware parameters.

`robots` has one entry per drone, which names its type; `robot_types` has what drones of a type share; `all` what all
drones share. A robot's entry overrides its type, and its type overrides `all`, key by key, also within nested tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.validation import checked

FILEVERSION = 3


class YamlBattery(BaseModel):
    """Limits of a battery's voltage [V]; None: not given."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    voltage_warning: Annotated[FiniteFloat, Field(ge=0, le=100)] | None = None
    voltage_critical: Annotated[FiniteFloat, Field(ge=0, le=100)] | None = None


class YamlDrone(BaseModel):
    """One enabled drone: its key under `robots`, place before take-off [m], and voltage limits for a drone at rest."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    name: str
    uri: Annotated[str, Field(pattern="://")]
    home: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(alias="initial_position")
    firmware_params: dict[str, dict[str, FiniteFloat]] = Field(default_factory=dict)
    battery: YamlBattery = YamlBattery()

    @property
    def parameters(self) -> dict[str, float]:
        """Firmware parameters, by `group.name`."""
        return {
            f"{group}.{key}": value for group, values in self.firmware_params.items() for key, value in values.items()
        }


def read_crazyflies(path: Path) -> tuple[YamlDrone, ...]:
    """The enabled drones of a file, in order; InputError names the field that cannot be used."""
    require("crazyflie", "--crazyflies")
    import yaml

    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, ValueError, LookupError) as error:
        reason = getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError("crazyflies", str(path), f"a YAML file that can be read ({reason})") from None
    return parse_crazyflies(content)


def parse_crazyflies(content: object) -> tuple[YamlDrone, ...]:
    """As `read_crazyflies`, by a file's content."""
    top = _table("crazyflies", content)
    version = top.get("fileversion", FILEVERSION)
    if version != FILEVERSION:
        raise InputError("fileversion", version, f"{FILEVERSION}")
    kinds, shared, robots = (_table(key, top.get(key)) for key in ("robot_types", "all", "robots"))
    drones: list[YamlDrone] = []
    for name, entry in robots.items():
        own = _table(f"robots.{name}", entry)
        if own.get("enabled", False) is not True:
            continue
        kind = own.get("type")
        if not isinstance(kind, str) or kind not in kinds:
            raise InputError(f"robots.{name}.type", kind, f"one of robot_types: {', '.join(kinds) or 'there is none'}")
        merged = _merge(_merge(shared, _table(f"robot_types.{kind}", kinds[kind])), own)
        drones.append(checked(YamlDrone, {**merged, "name": name}, f"robots.{name}"))
    if not drones:
        raise InputError("robots", list(robots), "at least one that is enabled")
    return tuple(drones)


def _table(field: str, value: object) -> dict[str, Any]:
    """A table with names as keys; an absent one is empty."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(field, value, "a table")
    return {str(key): entry for key, entry in cast("dict[Any, Any]", value).items()}


def _merge(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """All keys of both; `over` wins, also within nested tables."""
    merged = dict(under)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(cast("dict[str, Any]", below), cast("dict[str, Any]", value))
        else:
            merged[key] = value
    return merged
