"""Options that commands share, and flags made from the configuration: one per field, with its description as help."""

from __future__ import annotations

import inspect
import json
import types
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from llm_flock import formations
from llm_flock.errors import InputError
from llm_flock.runtime.config import RunConfig

Config = TypeVar("Config", bound=RunConfig)

EXIT_FAILED = 1
EXIT_INPUT = 2
EXIT_INTERRUPTED = 130

ConfigPath = Annotated[Path | None, typer.Option(help="Configuration file (TOML); flags override it")]
JsonOutput = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables")]
Record = Annotated[bool, typer.Option("--record/--no-record", help="Write a record")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no live progress")]

SHORT = {"n_robots": "--robots"}
"""Flags that are shorter than the name of their field."""

JSON_LISTS = frozenset({"obstacles", "changes", "drones"})
"""Fields that are lists of tables: their flags take JSON, or the name of a JSON file."""

NOT_FLAGS = frozenset({"points"})
"""Fields without a flag: `--shape points:FILE` sets them."""

SET_BY_COMPARE = frozenset({"protocol", "shape", "n_robots", "seed", "out", "record_llm"})
"""Fields that `compare` sets itself: they differ between its cells or trials, or are files of a single run."""

SET_BY_SWEEP = SET_BY_COMPARE
"""Fields that a sweep sets itself: axes of its grid, and the directory of its results."""

SET_BY_SWARM = frozenset({"kill", "join", "kill_random", "join_random", "changes", "noise", "velocity", "rounds"})
"""Fields of runs that swarms of processes do not support."""

SET_BY_FLY = frozenset({"kill", "join", "kill_random", "join_random", "noise", "start_positions"})
"""Fields of runs that flights do not support."""

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
}


def _parameter(field: str, info: FieldInfo, panel: str) -> inspect.Parameter:
    """A flag as the keyword parameter of a command; None means not given."""
    kind, metavar = (str, "JSON|FILE") if field in JSON_LISTS else _flag_type(info.annotation)
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
    without: frozenset[str] = frozenset(), kind: type[RunConfig] = RunConfig
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a flag for each field of the configuration except some to a command that takes them as `**flags`."""
    left_out = NOT_FLAGS | without

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        given = inspect.signature(command, eval_str=True).parameters.values()
        parameters = [p for p in given if p.kind is not p.VAR_KEYWORD]
        for name, section_info in kind.model_fields.items():
            section = section_info.annotation
            assert isinstance(section, type) and issubclass(section, BaseModel)
            fields = section.model_fields.items()
            parameters += [_parameter(field, info, PANELS[name]) for field, info in fields if field not in left_out]
        vars(command)["__signature__"] = inspect.Signature(parameters)
        command.__annotations__ = {p.name: p.annotation for p in parameters}
        return command

    return decorate


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
    if "geofence" in values:
        box = _numbers("geofence", values["geofence"])
        values["geofence"] = (box[:3], box[3:])
    for field in JSON_LISTS & values.keys():
        values[field] = _json_list(field, values[field])
    if "start_positions" in values:
        values["start_positions"] = formations.load_points(Path(values["start_positions"]), "start_positions")
    return values


def with_output_folder(settings: Config, kind: str = "", *, record: bool) -> Config:
    """The configuration with an output folder: its own, or else a new one under runs/; with none if not recorded."""
    folder = settings.trial.out
    if folder is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        folder = f"runs/{stamp}-{kind}{settings.mission.shape.split(':')[0]}-{settings.mission.n_robots}"
    trial = settings.trial.model_copy(update={"out": folder if record else None})
    return settings.model_copy(update={"trial": trial})


def _json_list(field: str, text: str) -> list[Any]:
    """A JSON list, or the name of a file that holds one."""
    try:
        found = json.loads(text if text.lstrip().startswith("[") else Path(text).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(field, text, f"a JSON list, or a file with one ({error})") from None
    if not isinstance(found, list):
        raise InputError(field, text, f"a JSON list of {field}")
    return cast("list[Any]", found)


def _numbers(field: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.strip("[]()").split(","))
    except ValueError:
        raise InputError(field, text, "numbers with commas between them, such as 50,50") from None
