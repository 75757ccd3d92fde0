"""Commands with a short help in plain text, and with input errors that name the flag as it was typed."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from copy import copy
from typing import Any, Self, cast

import typer
from typer.core import TyperArgument, TyperCommand

from llm_flock.errors import MAX_SHOWN, FieldError, InputError
from llm_flock.printable import one_line

ALL = "--help-all"
_FROM_FILE = "--config"


class PlainHelp(TyperCommand):
    """A command with help in plain text, where `[m]` is a unit and no markup.

    `--help` leaves out hidden flags. `--help-all` lists them too, and the shell completes them.
    """

    def invoke(self, ctx: typer.Context) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Run the command.

        Raises:
            InputError: as the command raises it, with flags in its text.
        """
        try:
            return super().invoke(ctx)
        except InputError as error:
            if isinstance(error, FieldError):
                raise
            raise FieldError(error.field, error.value, says=in_flags(error, self, sys.argv[1:])) from None

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments, unless all flags are to be listed."""
        if ALL in args and not ctx.resilient_parsing:
            typer.echo(self._whole().get_help(ctx))
            ctx.exit()
        return super().parse_args(ctx, args)

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """Flags that ask for help."""
        names = sorted(super().get_help_option_names(ctx), key=len)
        return [*names, ALL] if self._hidden() else names

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, one part for each panel."""
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        panels: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record is not None:
                usual = "Arguments" if isinstance(param, TyperArgument) else "Options"
                panels.setdefault(getattr(param, "rich_help_panel", None) or usual, []).append(record)
        for panel, records in panels.items():
            with formatter.section(panel):
                formatter.write_dl(records)
        if hidden := self._hidden():
            formatter.write_paragraph()
            formatter.write_text(f"{hidden} more flags: {ctx.command_path} {ALL}")

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Completions of a flag, or of its value."""
        return TyperCommand.shell_complete(self._whole(), ctx, incomplete)

    def _hidden(self) -> int:
        return sum(getattr(param, "hidden", False) for param in self.params)

    def _whole(self) -> Self:
        """The same command with nothing hidden."""
        whole = copy(self)
        whole.params = [copy(param) for param in self.params]
        for param in whole.params:
            vars(param)["hidden"] = False
        return whole


def in_flags(error: InputError, command: TyperCommand, argv: Sequence[str]) -> str:
    """The error with the flag or argument of `command` that sets its field, if that was typed or has its default.

    A field of a configuration file keeps its name.
    """
    field, _, place = error.field.partition(".")
    own = "--" + field.replace("_", "-")
    parameter = next((p for p in command.params if field in (p.name, _metavar(p)) or own in p.opts), None)
    if parameter is None:
        return str(error)
    if isinstance(parameter, TyperArgument):
        given = _metavar(parameter).upper() if error.value is None else _word(error.value)
        return f"{given or error.field}: {error.says}"
    names = [*parameter.opts, *parameter.secondary_opts]
    typed = next((k for k, word in enumerate(argv) if word.partition("=")[0] in names), None)
    if typed is None and any(word.partition("=")[0] == _FROM_FILE for word in argv):
        return str(error)
    flag, equals, text = ("", "", "") if typed is None else argv[typed].partition("=")
    if not equals and typed is not None and not isinstance(error.value, bool):
        text = " ".join(argv[typed + 1 : typed + 2])
    shown = error.value if isinstance(error.value, int | float | str) or not text else text
    if place and not all(part.isdecimal() for part in place.split(".")):
        return f"{flag or names[0]}, {place} = {_word(error.value)}: {error.says}"
    given = "" if error.value is None or isinstance(error.value, bool) else f" {_word(text if place else shown)}"
    return f"{flag or names[0]}{given}: {error.says}"


def _metavar(parameter: object) -> str:
    """The name of an argument as the help shows it, `record` of `[RECORD]...`."""
    return str(getattr(parameter, "metavar", None) or "").strip("[].").lower()


def _word(value: object) -> str:
    """A value as typed in a shell, on one line."""
    return shlex.quote(one_line(_typed_text(value), MAX_SHOWN))


def _typed_text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_typed_text, cast("Sequence[object]", value)))
    return f"{value:g}" if isinstance(value, float) else str(value)
