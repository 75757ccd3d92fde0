"""The commands by name. Each is built when it is called: its flags may come from classes that take long to import."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

from llm_flock.cli.options import add_config_flags
from llm_flock.flags import PlainHelp

Function = TypeVar("Function", bound=Callable[..., None])

_FUNCTIONS: dict[str, Callable[..., None]] = {}
_GROUPS: dict[str, typer.Typer] = {}


def command(function: Function) -> Function:
    """Add a function to the commands, under its name."""
    _FUNCTIONS[function.__name__.replace("_", "-")] = function
    return function


def add_group(name: str, group: typer.Typer) -> None:
    """Add a command that has commands of its own."""
    _FUNCTIONS[name] = lambda: None
    _GROUPS[name] = group


class _Built(Mapping[str, Any]):
    """The commands with all their flags, each built when it is looked up."""

    def __getitem__(self, name: str) -> Any:
        function = _FUNCTIONS[name]
        group = _GROUPS.get(name)
        if group is None:
            group = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
            group.command(name, cls=PlainHelp)(add_config_flags(function))
        built = typer.main.get_command(group)
        built.name = name
        return built

    def __iter__(self) -> Iterator[str]:
        return iter(_FUNCTIONS)

    def __len__(self) -> int:
        return len(_FUNCTIONS)


class Commands(TyperGroup):
    """Lists commands by their first line of help alone, and builds the one that is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _Built()

    def list_commands(self, ctx: Any) -> list[str]:
        """Names, in the order of the help."""
        return list(_FUNCTIONS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """What a list of commands shows of one; None if there is none of this name."""
        if cmd_name not in _FUNCTIONS:
            return None
        group = _GROUPS.get(cmd_name)
        text = _FUNCTIONS[cmd_name].__doc__ if group is None else str(group.info.help)
        return TyperCommand(cmd_name, help=text)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is called, with all its flags, and the arguments that are left for it."""
        name, listed, rest = super().resolve_command(ctx, args)
        return name, self.commands[name] if listed is not None and name is not None else None, rest
