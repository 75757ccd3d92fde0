"""Options that commands share, and flags made from the configuration: one per field, with its description as help."""

from __future__ import annotations

import functools
import importlib
import inspect
import json
import types
from collections.abc import Callable, Collection
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar, Union, cast, get_args, get_origin

import typer

from llm_flock.errors import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from llm_flock.runtime._config import RunConfig

Config = TypeVar("Config", bound="RunConfig")
Command: TypeAlias = Callable[..., None]
Reader: TypeAlias = Callable[[str, Any], Any]
"""Makes a value of the configuration from the field's name and the typed text."""

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130

ConfigPath = Annotated[Path | None, typer.Option(help="Configuration file (TOML); flags override it")]
JsonOutput = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables")]
Record = Annotated[bool, typer.Option("--record/--no-record", help="Write a record")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no live progress")]


def with_config_flags(
    config: str = "llm_flock.runtime._config:RunConfig",
    *,
    shown: Collection[str],
    without: Collection[str] = (),
) -> Callable[[Command], Command]:
    """Give a command a flag for each field of a configuration; it gets the typed values as `**flags`.

    `config` is the module and name of its class, which takes long to import; `--help` lists the flags of the fields
    `shown`. `without` are fields that get no flag, and sections, such as `[links]`, whose fields get none.
    """

    def decorate(command: Command) -> Command:
        vars(command)["config_flags"] = config, shown, {"points", *without}  # `--shape points:FILE` sets them
        return command

    return decorate


def add_config_flags(command: Command) -> Command:
    """The command with the flags of `with_config_flags`. Call when it is looked up."""
    if "config_flags" not in vars(command):
        return command
    config, shown, without = vars(command)["config_flags"]
    module, _, name = config.partition(":")
    parameters = [
        p for p in inspect.signature(command, eval_str=True).parameters.values() if p.kind is not p.VAR_KEYWORD
    ]
    from llm_flock.validation import fields_of

    readers: dict[str, Reader] = {}
    for title, section in getattr(importlib.import_module(module), name).model_fields.items():
        panel = section.title or title.capitalize()
        for field, info in fields_of(section.annotation).items():
            if field not in without and f"[{title}]" not in without:
                parameter, readers[field] = _flag(field, info, panel, hidden=field not in shown)
                parameters.append(parameter)

    def call(**given: Any) -> None:
        typed = {field: given.pop(field) for field in readers}
        flags = {field: readers[field](field, value) for field, value in typed.items() if value is not None}
        command(**given, **flags)

    return with_parameters(command, call, parameters)


def with_parameters(command: Command, call: Command, parameters: list[inspect.Parameter]) -> Command:
    """A function to be called in place of a command, with its name and help, and these parameters."""
    functools.update_wrapper(call, command)
    vars(call)["__signature__"] = inspect.Signature(parameters)
    call.__annotations__ = {p.name: p.annotation for p in parameters if p.kind is not p.VAR_KEYWORD}
    return call


def _flag(field: str, info: FieldInfo, panel: str, *, hidden: bool) -> tuple[inspect.Parameter, Reader]:
    """A flag as the keyword parameter of a command, where None means not given; and its reader."""
    from llm_flock.validation import extra

    metavar, read = _form(info.annotation)
    flag = f"--{extra(info, 'flag') or field.replace('_', '-')}"
    default = _default_text(info.get_default(call_default_factory=True))
    option = typer.Option(
        flag if metavar else f"{flag}/--no-{flag[2:]}",
        help=f"{info.description}  [default: {default}]" if default else info.description,
        metavar=metavar,
        hidden=hidden,
        rich_help_panel=panel,
        show_default=False,
    )
    annotation = Annotated[(str if metavar else bool) | None, option]
    return inspect.Parameter(field, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation), read


def _default_text(value: object) -> str:
    """A default, as typed on the command line; empty where there is none."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return str(cast("tuple[Any, ...]", value)).replace(" ", "").strip("()").replace("),(", ",")
    return "" if value is None else str(value)


def _form(annotation: Any) -> tuple[str | None, Reader]:
    """The placeholder for a value of this type in the help, empty for a switch; and the reader of the value."""
    from pydantic import BaseModel

    kind = _bare(annotation)
    parts = get_args(kind)
    if get_origin(kind) is Literal:
        return "|".join(parts), _text
    if get_origin(kind) is tuple:
        item = _bare(parts[0])
        if isinstance(item, type) and issubclass(item, BaseModel):
            return "JSON|FILE", _json_list
        if get_origin(item) is not tuple:
            return "X,Y,...", _numbers
        return ("FILE", _points) if parts[-1] is Ellipsis else ("X,Y,...", _corners)
    return {bool: (None, _text), int: ("INTEGER", _whole), float: ("FLOAT", _text), str: ("TEXT", _text)}[kind]


def _bare(annotation: Any) -> Any:
    """A type without its limits, and without None."""
    while get_origin(annotation) in (Annotated, Union, types.UnionType):
        annotation = next(part for part in get_args(annotation) if part is not type(None))
    return annotation


def _text(field: str, value: Any) -> Any:
    """The typed value: the configuration reads numbers."""
    return value


def _whole(field: str, text: str) -> int | str:
    """A whole number, so that the configuration checks its size."""
    try:
        return int(text)
    except ValueError:
        return text


def _numbers(field: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.strip("[]()").split(","))
    except ValueError:
        raise InputError(field, text, "numbers with commas between them, such as 50,50") from None


def _corners(field: str, text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Two opposite corners; with one alone, the other is the origin."""
    numbers = _numbers(field, text)
    if len(numbers) < 4:
        return (0.0,) * len(numbers), numbers
    half = len(numbers) // 2
    return numbers[:half], numbers[half:]


def _points(field: str, name: str) -> Any:
    from llm_flock.point_files import load_points

    return load_points(name, field)


def _json_list(field: str, text: str) -> list[Any]:
    """A JSON list, or the name of a file that holds one."""
    try:
        given = text if text.lstrip()[:1] in ("[", "{") else Path(text).read_text(encoding="utf-8")
        value = json.loads(given)
    except json.JSONDecodeError as error:
        raise InputError(field, None, says=f"broken JSON: {error}") from None
    except (OSError, ValueError, RecursionError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(field, text, f"a JSON list, or the name of a file with one ({why})") from None
    if not isinstance(value, list):
        raise InputError(field, text, "a JSON list: [...]")
    return cast("list[Any]", value)


def with_output_folder(settings: Config, kind: str = "", *, record: bool, typed: str | None = None) -> Config:
    """The configuration with its output folder, or a new one under runs/; without one if nothing is recorded."""
    if typed is not None and not record:
        raise InputError("out", typed, says="has no effect with --no-record")
    folder = settings.trial.out
    if folder is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        folder = f"runs/{stamp}-{kind}{settings.mission.shape.split(':')[0]}-{settings.mission.n_robots}"
    trial = settings.trial.model_copy(update={"out": folder if record else None})
    return settings.model_copy(update={"trial": trial})
