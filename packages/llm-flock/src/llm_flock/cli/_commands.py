"""The commands by name. Each is built when it is called, because classes that give its flags import slowly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module, metadata
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from llm_flock import plugins
from llm_flock.cli._extensions import with_extensions
from llm_flock.cli._options import add_config_flags
from llm_flock.errors import FieldError
from llm_flock.extras import EXTRAS
from llm_flock.flags import PlainHelp

_CORE = {
    "run": "llm_flock.cli._run",
    "inspect": "llm_flock.cli._display",
    "export": "llm_flock.cli._export",
    "doctor": "llm_flock.cli._doctor",
    "shapes": "llm_flock.cli._doctor",
    "models": "llm_flock.cli._doctor",
}
"""Commands of the core by name, each with the module of its function; plug-ins add theirs."""


def _names() -> list[str]:
    """All commands, in the order of the help."""
    return list({**_CORE, **plugins.entries("commands")})


def _find(name: str) -> Callable[..., None] | typer.Typer:
    return getattr(import_module(_CORE[name]), name) if name in _CORE else plugins.load("commands", name)


class _Built(Mapping[str, Any]):
    """The commands with all their flags, each built when it is looked up."""

    def __getitem__(self, name: str) -> Any:
        command = _find(name)
        if isinstance(command, typer.Typer):
            group = command
        else:
            group = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
            group.command(name, cls=PlainHelp)(add_config_flags(with_extensions(command)))
        built = typer.main.get_command(group)
        built.name = name
        return built

    def __iter__(self) -> Iterator[str]:
        return iter(_names())

    def __len__(self) -> int:
        return len(_names())


class Commands(TyperGroup):
    """Lists commands by their first lines of help, and builds only the one that is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _Built()

    def list_commands(self, ctx: Any) -> list[str]:
        """Names, in the order of the help."""
        return _names()

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command for lists, with its help alone; None if there is none of this name."""
        if cmd_name not in _names():
            return None
        command = _find(cmd_name)
        text = str(command.info.help) if isinstance(command, typer.Typer) else command.__doc__
        return TyperCommand(cmd_name, help=text)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The called command with all its flags, and its arguments."""
        absent = next((extra for extra in EXTRAS.values() if args[0] in extra.commands), None)
        if absent is not None and args[0] not in _names():
            raise FieldError("extra", absent.name, says=f"{args[0]} needs the extra {absent.name}: {absent.install}")
        name, listed, rest = super().resolve_command(ctx, args)
        return name, self.commands[name] if listed is not None and name is not None else None, rest


app = typer.Typer(
    name="llm-flock",
    cls=Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def start(
    ctx: typer.Context,
    versions: Annotated[bool, typer.Option("--version", help="Print the versions of the installed parts")] = False,
) -> None:
    """Robots that agree on a formation, each with its own language model and without a central controller."""
    if versions:
        parts = {part.name: part.version for part in metadata.distributions() if part.name.startswith("llm-flock")}
        typer.echo("\n".join(f"{name} {version}" for name, version in sorted(parts.items())))
    elif ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
