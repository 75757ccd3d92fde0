"""Crazyswarm2's `crazyflies.yaml`, fileversion 3: which drones there are, where they start, and what they are set to.

`robots` has one entry a drone, which names its type; `robot_types` has what all of a type share; `all` what all share.
What a robot says goes before its type, and its type before `all`, key by key, also within nested tables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from llm_flock.errors import InputError
from llm_flock.robots.base import Position

FILEVERSION = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class YamlDrone:
    """One enabled drone of the file.

    Attributes:
        name: its key under `robots`.
        uri: `radio://0/80/2M/E7E7E7E701` and so on.
        home: where it stands at first [m].
        kind: its type.
        parameters: firmware parameters, by `group.name`.
        battery_warning_v: [V]; None where the file does not say.
        battery_critical_v: [V]; None where the file does not say.
    """

    name: str
    uri: str
    home: Position
    kind: str
    parameters: Mapping[str, float]
    battery_warning_v: float | None = None
    battery_critical_v: float | None = None


def read_crazyflies(path: Path) -> tuple[YamlDrone, ...]:
    """The enabled drones of a file, in its order.

    Raises:
        InputError: no such file, no YAML, another version, or an entry that cannot be used; the field says where.
    """
    try:
        import yaml
    except ImportError:
        raise InputError(
            "crazyflies", str(path), "readable once installed: pip install 'llm-flock[crazyflie]'"
        ) from None
    try:
        text = path.read_text(encoding="utf-8")
        content: Any = yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError("crazyflies", str(path), f"a YAML file that can be read ({_first_line(error)})") from None
    return parse_crazyflies(content)


def parse_crazyflies(content: object) -> tuple[YamlDrone, ...]:
    """The enabled drones of a file's content.

    Raises:
        InputError: as for `read_crazyflies`.
    """
    top = _table("crazyflies", content)
    version = top.get("fileversion", FILEVERSION)
    if version != FILEVERSION:
        raise InputError("fileversion", version, f"{FILEVERSION}")
    kinds = _table("robot_types", top.get("robot_types"))
    shared = _table("all", top.get("all"))
    robots = _table("robots", top.get("robots"))
    drones: list[YamlDrone] = []
    for name, entry in robots.items():
        where = f"robots.{name}"
        own = _table(where, entry)
        if own.get("enabled", False) is not True:
            continue
        kind = own.get("type")
        if kind not in kinds:
            raise InputError(f"{where}.type", kind, f"one of robot_types: {', '.join(kinds) or 'there is none'}")
        merged = _merge(_merge(shared, _table(f"robot_types.{kind}", kinds[kind])), own)
        drones.append(_drone(name, kind, where, merged))
    if not drones:
        raise InputError("robots", list(robots), "at least one that is enabled")
    uris = [drone.uri for drone in drones]
    for drone in drones:
        if uris.count(drone.uri) > 1:
            raise InputError(f"robots.{drone.name}.uri", drone.uri, "a URI that no other enabled robot has")
    return tuple(drones)


def _drone(name: str, kind: str, where: str, merged: Mapping[str, Any]) -> YamlDrone:
    uri = merged.get("uri")
    if not isinstance(uri, str) or "://" not in uri:
        raise InputError(f"{where}.uri", uri, "a URI such as radio://0/80/2M/E7E7E7E701")
    home = _rows(merged.get("initial_position"))
    if len(home) != 3:
        raise InputError(f"{where}.initial_position", merged.get("initial_position"), "three numbers [m]")
    x, y, z = (_number(f"{where}.initial_position", value) for value in home)
    battery = _table(f"{where}.battery", merged.get("battery"))
    parameters: dict[str, float] = {}
    for group, values in _table(f"{where}.firmware_params", merged.get("firmware_params")).items():
        for key, value in _table(f"{where}.firmware_params.{group}", values).items():
            parameters[f"{group}.{key}"] = _number(f"{where}.firmware_params.{group}.{key}", value)
    return YamlDrone(
        name=name,
        uri=uri,
        home=(x, y, z),
        kind=kind,
        parameters=parameters,
        battery_warning_v=_volts(f"{where}.battery.voltage_warning", battery.get("voltage_warning")),
        battery_critical_v=_volts(f"{where}.battery.voltage_critical", battery.get("voltage_critical")),
    )


def _rows(value: object) -> list[Any]:
    return cast("list[Any]", value) if isinstance(value, list) else []


def _volts(field: str, value: object) -> float | None:
    return None if value is None else _number(field, value)


def _number(field: str, value: object) -> float:
    """A number; YAML 1.1 takes one such as 1e-3, which has no point, for text."""
    number = math.nan
    if isinstance(value, int | float | str):
        try:
            number = float(value)
        except ValueError:
            number = math.nan
    if not math.isfinite(number):
        raise InputError(field, value, "a finite number")
    return number


def _table(field: str, value: object) -> dict[str, Any]:
    """A table with names as keys; an absent one is empty."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(field, value, "a table")
    return {str(key): entry for key, entry in cast("dict[Any, Any]", value).items()}


def _merge(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """All keys of both; `over` wins, within nested tables too."""
    merged = dict(under)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(cast("dict[str, Any]", below), cast("dict[str, Any]", value))
        else:
            merged[key] = value
    return merged


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
