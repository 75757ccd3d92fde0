"""Options that commands share, and flags made from the configuration: one per field, with its description as help."""

from __future__ import annotations

import importlib
import inspect
import json
import types
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

import typer

from llm_flock.errors import InputError
from llm_flock.text_files import read_text

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from llm_flock.runtime.config import RunConfig
    from llm_flock.runtime.flight.config import FlightConfig
    from llm_flock.runtime.network.config import SwarmConfig

Config = TypeVar("Config", bound="RunConfig")
Shown = TypeVar("Shown", "SwarmConfig", "FlightConfig")

RUN = "llm_flock.runtime.config:RunConfig"
SWARM = "llm_flock.runtime.network.config:SwarmConfig"
FLIGHT = "llm_flock.runtime.flight.config:FlightConfig"
"""Configurations, named: most commands do not need their classes, which take long to import."""

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130

ConfigPath = Annotated[Path | None, typer.Option(help="Configuration file (TOML); flags override it")]
JsonOutput = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables")]
Record = Annotated[bool, typer.Option("--record/--no-record", help="Write a record")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no live progress")]

SHORT = {"n_robots": "--robots", "router": "--ros2"}
"""Flags that are called otherwise than their field."""

JSON_LISTS = frozenset({"obstacles", "changes", "drones"})
"""Fields that are lists of tables: their flags take JSON, or the name of a JSON file."""

SHOWN_AS = {**dict.fromkeys(sorted(JSON_LISTS), "JSON|FILE"), "start_positions": "FILE"}
"""What help shows in place of a value, where it does not follow from the field's type."""

NOT_FLAGS = frozenset({"points"})
"""Fields without a flag: `--shape points:FILE` sets them."""

SHOWN = 20
"""Characters that an error shows on either side of the place where JSON breaks."""

SET_BY_COMPARE = frozenset({"protocol", "shape", "n_robots", "seed", "out", "record_llm"})
"""Fields that `compare` sets itself: they differ between its cells or trials, or are files of a single run."""

SET_BY_SWEEP = SET_BY_COMPARE
"""Fields that a sweep sets itself: axes of its grid, and the directory of its results."""

SET_BY_SWARM = frozenset({"kill", "join", "kill_random", "join_random", "changes", "noise", "velocity", "rounds"})
"""Fields of runs that swarms of processes do not support."""

FROM_ROS = frozenset({"ros_missions", "ros_poses", "ros_pose_topic"})
"""Fields of what comes in from ROS 2."""

SET_BY_FLY = frozenset(
    ("kill", "join", "kill_random", "join_random", "noise", "start_positions", "unit_m", "use_sim_time")
    + ("ros_missions", "ros_poses")
)
"""Fields of runs and swarms that flights do not support."""

ROS2 = FROM_ROS.union(("router", "ros_domain", "ros_namespace", "ros_frame", "ros_rate_hz", "unit_m", "use_sim_time"))
"""Fields of the bridge to ROS 2, which is no part of a robot or a world."""

PANELS = {
    "mission": "Mission",
    "protocol": "Protocol",
    "model": "Language models",
    "limits": "Limits and budget",
    "links": "Messages",
    "trial": "Run",
    "network": "Network",
    "world": "World",
    "fleet": "Drones",
    "safety": "Safety",
    "positions": "Positions from outside",
    "ros2": "ROS 2",
}


def _parameter(field: str, info: FieldInfo, panel: str) -> inspect.Parameter:
    """A flag as the keyword parameter of a command; None means not given."""
    kind, metavar = (str, SHOWN_AS[field]) if field in SHOWN_AS else _flag_type(info.annotation)
    flag = SHORT.get(field, "--" + field.replace("_", "-"))
    shown = info.get_default(call_default_factory=True)
    option = typer.Option(
        f"{flag}/--no-{flag[2:]}" if kind is bool else flag,
        help=info.description,
        metavar=metavar,
        rich_help_panel=panel,
        show_default=False if shown is None else _shown(shown),
    )
    return inspect.Parameter(
        field, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[kind | None, option]
    )


def _shown(value: object) -> str:
    """A default, as typed on the command line."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return str(cast("tuple[Any, ...]", value)).replace(" ", "").strip("()").replace("),(", ",")
    return str(value)


def _flag_type(annotation: Any) -> tuple[Any, str | None]:
    """The type that a flag is read as, and its metavar; `parse_flags` splits lists of numbers, read as text."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _flag_type(get_args(annotation)[0])
    if origin in (Union, types.UnionType):
        return _flag_type(next(a for a in get_args(annotation) if a is not type(None)))
    if origin is tuple:
        return str, "X,Y,..."
    if origin is Literal:
        return str, "|".join(get_args(annotation))
    assert annotation in (bool, int, float, str), f"a flag cannot be made for {annotation}"
    return annotation, None


def with_config_flags(
    without: frozenset[str] = frozenset(), kind: str = RUN
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Ask for a flag for each field of a configuration except some, for a command that takes them as `**flags`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        vars(command)["config_flags"] = kind, NOT_FLAGS | without
        return command

    return decorate


def add_config_flags(command: Callable[..., None]) -> None:
    """Add the flags that a command asks for by `with_config_flags`, before it is called."""
    asked = vars(command).pop("config_flags", None)
    if asked is None:
        return
    from pydantic import BaseModel

    kind, left_out = asked
    module, _, name = kind.partition(":")
    config: type[RunConfig] = getattr(importlib.import_module(module), name)
    given = inspect.signature(command, eval_str=True).parameters.values()
    parameters = [p for p in given if p.kind is not p.VAR_KEYWORD]
    for name, section_info in config.model_fields.items():
        section = section_info.annotation
        assert isinstance(section, type) and issubclass(section, BaseModel)
        fields = section.model_fields.items()
        parameters += [_parameter(field, info, PANELS[name]) for field, info in fields if field not in left_out]
    vars(command)["__signature__"] = inspect.Signature(parameters)
    command.__annotations__ = {p.name: p.annotation for p in parameters}


def parse_flags(flags: dict[str, Any]) -> dict[str, Any]:
    """Flag values as configuration values. Call on the `**flags` of a command.

    Raises:
        InputError: a list of numbers cannot be read.
    """
    values = {field: value for field, value in flags.items() if value is not None}
    for field in ("center", "velocity", "origin_m"):
        if field in values:
            values[field] = _numbers(field, values[field])
    if "arena" in values:
        corner = _numbers("arena", values["arena"])
        half = len(corner) // 2
        low, high = (corner[:half], corner[half:]) if len(corner) >= 4 else ((0.0,) * len(corner), corner)
        values["arena"] = (low, high)
    if "start_area" in values:
        corner = _numbers("start_area", values["start_area"])
        values["start_area"] = (corner[: len(corner) // 2], corner[len(corner) // 2 :])
    if "geofence" in values:
        box = _numbers("geofence", values["geofence"])
        values["geofence"] = (box[:3], box[3:])
    for field in JSON_LISTS & values.keys():
        values[field] = _json_list(field, values[field])
    if "start_positions" in values:
        from llm_flock.formations.files import load_points

        values["start_positions"] = load_points(Path(values["start_positions"]), "start_positions")
    return values


def load_shown(kind: type[Shown], config: Path | None, flags: dict[str, Any]) -> Shown:
    """The configuration of a command that may show its team in ROS 2.

    Raises:
        InputError: a value is not allowed, or a flag of ROS 2 was typed and there is no --ros2.
    """
    settings = kind.load(config, **parse_flags(flags))
    if settings.ros2.router is None:
        refuse_ros2(flags, "has no effect without --ros2")
    return settings


def refuse_ros2(flags: Mapping[str, Any], says: str) -> None:
    """Refuse the flags of ROS 2. What a file says about ROS 2 may stay there.

    Raises:
        InputError: one was typed.
    """
    for field, value in flags.items():
        if field in ROS2 and value is not None:
            raise InputError(field, value, says=says)


def with_output_folder(settings: Config, kind: str = "", *, record: bool, typed: str | None = None) -> Config:
    """The configuration with an output folder: its own, or else a new one under runs/; with none if not recorded.

    Raises:
        InputError: a folder was typed, and nothing is recorded.
    """
    if typed is not None and not record:
        raise InputError("out", typed, says="has no effect with --no-record")
    folder = settings.trial.out
    if folder is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        folder = f"runs/{stamp}-{kind}{settings.mission.shape.split(':')[0]}-{settings.mission.n_robots}"
    trial = settings.trial.model_copy(update={"out": folder if record else None})
    return settings.model_copy(update={"trial": trial})


def _json_list(field: str, text: str) -> list[Any]:
    """A JSON list, or the name of a file that holds one."""
    try:
        given = text if text.lstrip()[:1] in ("[", "{") else read_text(Path(text))
        found = json.loads(given)
    except json.JSONDecodeError as error:
        before, after = error.doc[: error.pos][-SHOWN:], error.doc[error.pos :][:SHOWN]
        where = f"after {before!r} comes {after!r}" if after.strip() else f"it ends after {before!r}"
        says = f"broken JSON in line {error.lineno}, column {error.colno}: {where} ({error.msg})"
        raise InputError(field, None, says=says) from None
    except (OSError, ValueError, RecursionError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(field, text, f"a JSON list, or the name of a file with one ({why})") from None
    if not isinstance(found, list):
        raise InputError(field, text, "a JSON list: [...]")
    return cast("list[Any]", found)


def _numbers(field: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.strip("[]()").split(","))
    except ValueError:
        raise InputError(field, text, "numbers with commas between them, such as 50,50") from None
