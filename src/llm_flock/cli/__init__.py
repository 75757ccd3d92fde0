"""The command line: thin, every command a few calls into the library."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from llm_flock.cli.accusations import show_accusations
from llm_flock.cli.commands import Commands, add_group, command
from llm_flock.cli.comparison import compare
from llm_flock.cli.display import (
    live_line,
    no_success,
    note_broken,
    note_replaced,
    show_conversation,
    show_overview,
    summary_table,
)
from llm_flock.cli.distill import distill
from llm_flock.cli.doctor import doctor, is_set
from llm_flock.cli.exam import exam
from llm_flock.cli.export import export
from llm_flock.cli.fly import fly
from llm_flock.cli.foxglove import PACE, Pacer, run_orders, showing_run
from llm_flock.cli.options import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    ConfigPath,
    JsonOutput,
    Quiet,
    Record,
    parse_flags,
    with_config_flags,
    with_output_folder,
)
from llm_flock.cli.report import report
from llm_flock.cli.stand_ins import stand_ins
from llm_flock.cli.swarm import mission, robot, ros2, swarm, watch, world
from llm_flock.cli.sweep import sweep
from llm_flock.cli.terminal import Screen, say
from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.foxglove.options import Service, with_foxglove
from llm_flock.viewer.command import view

app = typer.Typer(
    name="llm-flock",
    cls=Commands,
    help="Robots that agree on a formation, each with its own language model and without a central controller.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def start(ctx: typer.Context) -> None:
    """Robots that agree on a formation, each with its own language model and without a central controller."""
    if ctx.invoked_subcommand is None:
        from llm_flock.cli.start import show_next_steps

        show_next_steps()


RecordPath = Annotated[Path, typer.Argument(help="Record of a run (run.mcap), or the folder that holds it")]


@command
@with_config_flags()
@with_foxglove
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
            help=f"Rounds a second at most, 0.01 to 1000 [{PACE:g} with --foxglove, else no limit]",
            show_default=False,
        ),
    ] = None,
    *,
    service: Service,
    **flags: Any,
) -> None:
    """Fly one mission and record it. Every field of the configuration is a flag.

    Without --out, the record goes to a new folder under runs/.
    """
    from llm_flock.runtime.config import RunConfig
    from llm_flock.runtime.orders import RunOrders

    if pace is not None and not 0.01 <= pace <= 1000:
        raise InputError("pace", pace, "a number from 0.01 to 1000")
    settings = with_output_folder(RunConfig.load(config, **parse_flags(flags)), record=record, typed=flags["out"])
    if dry_run:
        service.refuse("a dry run")
        if pace is not None:
            raise InputError("pace", pace, says="has no effect in a dry run")
        from llm_flock.cli.expected import show_expected_run

        show_expected_run(settings, as_json=json_output, quiet=quiet)
        return
    from llm_flock.runtime.api import run as run_trial

    bar, on_round = live_line(settings.mission.shape, enabled=not quiet and not json_output)
    orders = RunOrders(settings)
    try:
        with showing_run(service, settings, run_orders(orders)) as sink, bar:
            pace = PACE if service.on and pace is None else pace
            steer = None if pace is None else Pacer(pace, orders)
            result = run_trial(config=settings, on_round=on_round, sink=sink, steer=steer, trace=False)
    except KeyboardInterrupt:
        where = f"; what was flown is in {settings.trial.out}" if settings.trial.out else ""
        say(f"interrupted{where}", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        say(json.dumps(result.summary.to_dict(), allow_nan=False))
    else:
        Screen().show(summary_table(result.summary, settings.mission.safe_distance))
    if result.summary.stopped in ("no_answers", "no_plan"):
        say(f"error: {no_success(result.summary, settings.protocol.fallback)}", error=True)
        raise typer.Exit(EXIT_FAILED)


for function in (compare, sweep, exam, fly, swarm, robot, world, mission, watch, ros2):
    command(function)


@command
def figure(
    records: Annotated[list[Path], typer.Argument(help="One or more records (run.mcap), or folders that hold one")],
    out: Annotated[Path | None, typer.Option(help="File to write; its suffix sets the format")] = None,
    kind: Annotated[
        str, typer.Option(help="snapshots, error or comparison [snapshots of one record, comparison of several]")
    ] = "",
    rounds: Annotated[str | None, typer.Option(help="Rounds of the snapshots, such as 0,4,7,12")] = None,
    label: Annotated[list[str] | None, typer.Option(help="Label of a record, in order; repeat for more")] = None,
) -> None:
    """Draw records: snapshots of one run, the error over time of many, or runs side by side."""
    require("figures", "figure")
    from llm_flock.record.reader import read_record

    paths = [_record_file(path) for path in records]
    runs = [read_record(path) for path in paths]
    from llm_flock.viz import figures

    kind = kind or ("snapshots" if len(runs) == 1 else "comparison")
    target = out or paths[0].with_name(f"{kind}.png")
    if kind == "snapshots":
        if len(runs) != 1:
            raise InputError("records", len(runs), "one record for snapshots")
        drawn = figures.snapshots(runs[0], None if rounds is None else _rounds(rounds))
    elif kind == "error":
        drawn = figures.error_over_time(runs, label or _labels(runs))
    elif kind == "comparison":
        drawn = figures.comparison(runs, label or _labels(runs))
    else:
        raise InputError("kind", kind, "snapshots, error or comparison")
    for field, value, used in (("rounds", rounds, kind == "snapshots"), ("label", label, kind != "snapshots")):
        if value and not used:
            raise InputError(field, value[0] if field == "label" else value, says=f"has no effect on {kind}")
    note_broken(runs)
    note_replaced(target)
    figures.save(drawn, target)
    say(target)


@command
def animate(
    record: RecordPath,
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, .gif, .mp4 or .webm [a GIF, and an MP4 too where ffmpeg is installed]"),
    ] = None,
    fps: Annotated[int, typer.Option(min=1, max=60, help="Frames per second")] = 12,
) -> None:
    """Draw a record as an animation."""
    require("figures", "animate")
    from llm_flock.record.reader import read_record

    path = _record_file(record)
    both = [path.with_name("animation.gif")] + ([path.with_name("animation.mp4")] if shutil.which("ffmpeg") else [])
    found = read_record(path)
    note_broken([found])
    from llm_flock.viz.animation import animate as draw

    for target in [out] if out else both:
        note_replaced(target)
        draw(found, target, fps=fps)
        say(target)


@command
def inspect(
    record: RecordPath,
    robot: Annotated[int | None, typer.Option(min=0, help="Show only this robot's conversation")] = None,
    round_number: Annotated[int | None, typer.Option("--round", min=0, help="Show only this round")] = None,
    team: Annotated[
        Path | None,
        typer.Option("--keys", metavar="DIR", help="Check accusations of lying with a team's public keys (team.json)"),
    ] = None,
) -> None:
    """Show a record: its summary, or the conversation of a robot with its model."""
    from llm_flock.record.reader import read_record

    found = read_record(_record_file(record))
    if robot is None and round_number is None:
        show_overview(found)
        show_accusations(found, team)
    else:
        show_conversation(found, robot, round_number)


@command
def keys(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder", show_default=False)],
    robots: Annotated[int, typer.Option(min=1, help="Number of robots", show_default=False)],
    days: Annotated[int, typer.Option(min=1, help="Validity of the certificates [days]")] = 365,
) -> None:
    """Make the keys and certificates of a team whose robots are separate processes.

    No file is overwritten. Each robot gets a folder: its machine needs that folder, team.json and ca.pem.
    """
    require("network", "keys")
    from llm_flock.trust.keys import make_keys

    make_keys(folder, robots, days=days)
    say(f"keys of {robots} robots, operator, world and watcher in {folder}; keep {folder / 'authority'} offline")


add_group("distill", distill)
for function in (view, report, export, stand_ins, doctor):
    command(function)


@command
def shapes() -> None:
    """List the formations and their possible team sizes."""
    from llm_flock import formations

    table = Table("shape", "robots", "description")
    for shape in formations.shapes():
        table.add_row(shape.name, shape.legal, shape.description)
    Screen().show(table, copied=("shape",))


@command
def models() -> None:
    """List the model providers, their environment variables, whether these are set, and examples."""
    from llm_flock.llm.providers import PROVIDERS

    table = Table("provider", "key in", "set", "default address", "example")
    for provider in PROVIDERS.values():
        known = "yes" if is_set(provider.key_env) else "no"
        table.add_row(provider.name, provider.key_env, known, provider.base_url or "-", provider.example)
    for name, example in (
        ("local", "local:smollm2"),
        ("simulated", "simulated:ideal"),
        ("geometry", "geometry"),
        ("replay", "replay:FILE"),
    ):
        table.add_row(name, "-", "-", "this process", example)
    Screen().show(table, copied=("key in", "default address", "example"))


def _record_file(path: Path) -> Path:
    """The record, also if its folder is given."""
    return path / "run.mcap" if path.is_dir() else path


def _rounds(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError("rounds", text, "round numbers with commas between them, such as 0,4,7") from None


def _labels(runs: list[Any]) -> list[str]:
    """Labels of runs: their protocols."""
    from llm_flock.record.words import protocol_text

    return [protocol_text(r.run.config) or "unknown protocol" for r in runs]
