"""Input errors in the words of the command line: the flag as it was typed, in place of the field that it sets."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Sequence
from copy import copy
from typing import Any, cast

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup

from llm_flock.errors import MOST_SHOWN, FieldError, InputError
from llm_flock.printable import one_line

_FROM_FILE = "--config"


class FlagErrors(TyperGroup):
    """A group of commands whose input errors name flags."""

    def invoke(self, ctx: typer.Context) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Run a command.

        Raises:
            InputError: as the command raises it, with flags in its text.
        """
        try:
            return super().invoke(ctx)
        except InputError as error:
            command = self.commands.get(ctx.invoked_subcommand or "")
            if isinstance(error, FieldError) or not isinstance(command, TyperCommand):
                raise
            raise FieldError(error.field, error.value, says=in_flags(error, command, sys.argv[1:])) from None


ROOMY = 110
"""Columns that the tables of every command's help need, so that no flag in them is cut."""


class PlainHelp(TyperCommand):
    """A command whose help is plain text: `[m]` in it is a unit, no markup."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help: in tables, or in a narrow terminal in plain lines."""
        if shutil.get_terminal_size().columns < ROOMY:
            self._format_narrow(ctx, formatter)
            return
        from rich.markup import escape  # slow to load, and rarely needed

        shown = copy(self)
        shown.params = [copy(param) for param in self.params]
        for param in shown.params:
            if text := getattr(param, "help", None):
                vars(param)["help"] = escape(text)
        shown.help = None if self.help is None else escape(self.help)
        TyperCommand.format_help(shown, ctx, formatter)

    def _format_narrow(self, ctx: Any, formatter: Any) -> None:
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
    return shlex.quote(one_line(_typed(value), MOST_SHOWN))


def _typed(value: object) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_typed, cast("Sequence[object]", value)))
    return f"{value:g}" if isinstance(value, float) else str(value)
