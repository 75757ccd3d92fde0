"""The application of the command line."""

from __future__ import annotations

import typer

from llm_flock.cli._commands import Commands

app = typer.Typer(
    name="llm-flock",
    cls=Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def start(ctx: typer.Context) -> None:
    """Robots that agree on a formation, each with its own language model and without a central controller."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
