"""`llm-flock run`: flies one mission in this process."""

from __future__ import annotations

import json
import signal
from typing import Annotated, Any

import typer

from llm_flock.cli._display import live_line, no_success, show_overview, summary_table
from llm_flock.cli._extensions import PACE, Extension, Pacer, chosen, extended, refuse, showing
from llm_flock.cli._options import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    ConfigPath,
    JsonOutput,
    Quiet,
    Record,
    with_config_flags,
    with_output_folder,
)
from llm_flock.cli._terminal import Screen, say
from llm_flock.cli._words import CONFIRMS, EDITS, READS, Words, confirmed_draft
from llm_flock.errors import InputError
from llm_flock.printable import shape_title

SHOWN = (
    *("shape", "n_robots", "obstacles", "protocol", "model", "base_url", "loss"),
    *("rounds", "seed", "kill", "out"),
)
"""Fields that `run --help` lists."""


@with_config_flags(shown=SHOWN)
@extended("sinks")
def run(
    config: ConfigPath = None,
    json_output: JsonOutput = False,
    record: Record = True,
    quiet: Quiet = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the calls, tokens and cost to expect, and ask no model")
    ] = False,
    pace: Annotated[
        float | None,
        typer.Option(
            help=f"Rounds a second at most, 0.01 to 1000 [{PACE:g} while it is shown live, else no limit]",
            show_default=False,
        ),
    ] = None,
    words: Words = None,
    edit: Annotated[str | None, typer.Option(help=EDITS, hidden=True)] = None,
    reader: Annotated[str | None, typer.Option(help=READS, hidden=True)] = None,
    yes: Annotated[bool, typer.Option("--yes", help=CONFIRMS, hidden=True)] = False,
    *,
    extensions: list[Extension],
    **flags: Any,
) -> None:
    """Fly one mission and record it. Every field of the configuration is a flag.

    Without --out, the record goes to a new folder under runs/.
    """
    from llm_flock.runtime._config import RunConfig

    sinks = chosen(extensions)
    if pace is not None and not 0.01 <= pace <= 1000:
        raise InputError("pace", pace, "a number from 0.01 to 1000")
    settings = RunConfig.load(config, **flags)
    if words is not None or edit is not None:
        draft = confirmed_draft(settings, words, edit, reader, yes=yes)
        settings = settings.flying(draft.mission, draft.gaps)
    elif reader is not None or yes:
        raise InputError("reader" if reader else "yes", reader, says="has no effect without --words or --edit")
    settings.check_orders()
    settings = with_output_folder(settings, record=record, typed=flags.get("out"))
    if dry_run:
        refuse(sinks, "a dry run")
        if pace is not None:
            raise InputError("pace", pace, says="has no effect in a dry run")
        from llm_flock.cli._expected import show_expected_run

        show_expected_run(settings, as_json=json_output, quiet=quiet)
        return
    from llm_flock.runtime._api import run as run_trial

    for name in ("SIGTERM", "SIGHUP"):  # an end that keeps the round's answers, also where the terminal is closed
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, frame: signal.raise_signal(signal.SIGINT))
    bar, on_round = live_line(shape_title(settings.mission.shape), enabled=not quiet and not json_output)
    try:
        with showing(sinks, settings) as sink, bar:
            pace = PACE if sinks and pace is None else pace
            steer = None if pace is None else Pacer(pace)
            result = run_trial(config=settings, on_round=on_round, sink=sink, steer=steer, trace=False)
    except KeyboardInterrupt:
        say("interrupted", error=True)
        if settings.record is not None:
            from llm_flock.record import read_record

            flown = read_record(settings.record)
            if json_output:
                say(json.dumps(flown.result, allow_nan=False))
            else:
                show_overview(flown)
            say(f"what was flown is in {settings.trial.out}", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        say(json.dumps(result.summary.to_dict(), allow_nan=False))
    else:
        Screen().show(summary_table(result))
    if result.summary.stopped in ("no_answers", "no_plan"):
        say(f"error: {no_success(result.summary, settings.protocol.fallback)}", error=True)
        raise typer.Exit(EXIT_FAILED)
