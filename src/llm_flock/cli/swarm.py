"""Commands of swarms in which each robot is a process of its own."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Coroutine
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from llm_flock.cli.display import LiveLine
from llm_flock.cli.options import SET_BY_SWARM, parse_flags, with_config_flags
from llm_flock.errors import InputError
from llm_flock.runtime.config import load_config_of
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.process import run

EXIT_INTERRUPTED = 130
EXIT_FAILED = 1

ConfigPath = Annotated[Path | None, typer.Option(help="Configuration file (TOML); flags override it")]
WITHOUT_OUT = SET_BY_SWARM | {"out"}


def _live(work: Coroutine[Any, Any, None]) -> None:
    try:
        run(work)
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_INTERRUPTED) from None


@with_config_flags(without=WITHOUT_OUT, kind=SwarmConfig)
def robot(
    robot_id: Annotated[int, typer.Option("--id", min=0, help="Which robot of the swarm this is")],
    config: ConfigPath = None,
    **flags: Any,
) -> None:
    """Be one robot of a swarm, until the process is ended."""
    from llm_flock.runtime.network.robot import run_robot

    _live(run_robot(load_config_of(SwarmConfig, config, **parse_flags(flags)), robot_id))


@with_config_flags(without=WITHOUT_OUT, kind=SwarmConfig)
def world(config: ConfigPath = None, **flags: Any) -> None:
    """Be the world of a swarm of simulated bodies: kinematics and sensors. It listens where the others connect to."""
    from llm_flock.runtime.network.swarm import world_config
    from llm_flock.runtime.network.world import run_world

    settings = world_config(load_config_of(SwarmConfig, config, **parse_flags(flags)))
    _live(run_world(settings, lambda: print(f"the world listens on {settings.network.listen}", file=sys.stderr)))


@with_config_flags(without=SET_BY_SWARM, kind=SwarmConfig)
def swarm(
    config: ConfigPath = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table")] = False,
    record: Annotated[bool, typer.Option("--record/--no-record", help="Write a record of the run")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No live progress")] = False,
    **flags: Any,
) -> None:
    """Fly one mission with a process for each robot, one for the world and one for the record, on this machine."""
    from llm_flock.runtime.network.swarm import run_swarm

    settings = load_config_of(SwarmConfig, config, **parse_flags(flags))
    folder = settings.trial.out
    if folder is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        folder = f"runs/{stamp}-swarm-{settings.mission.shape.split(':')[0]}-{settings.mission.n_robots}"
    trial = settings.trial.model_copy(update={"out": folder if record else None})
    settings = settings.model_copy(update={"trial": trial})
    try:
        with LiveLine(settings.mission.shape, enabled=not quiet and not json_output) as line:
            result = asyncio.run(run_swarm(settings, line.update))
    except KeyboardInterrupt:
        print(f"interrupted; all {settings.mission.n_robots} robots have ended", file=sys.stderr)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        print(json.dumps(result.to_dict(), allow_nan=False))
    else:
        simulated = " (simulated language models)" if result.simulated else ""
        title = escape(
            f"{settings.mission.shape}, {settings.mission.n_robots} robots, {settings.model.model}{simulated}"
        )
        table = Table(title=title, show_header=False, title_justify="left")
        for key, value in result.to_dict().items():
            table.add_row(key.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
        Console().print(table)
    if not result.formed:
        raise typer.Exit(EXIT_FAILED)


@with_config_flags(without=SET_BY_SWARM, kind=SwarmConfig)
def watch(
    config: ConfigPath = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No live progress")] = False,
    **flags: Any,
) -> None:
    """Watch a running swarm from outside, until Ctrl-C; with --out, record it."""
    from llm_flock.runtime.network.swarm import RECORD_NAME
    from llm_flock.runtime.network.watch import run_watch

    settings = load_config_of(SwarmConfig, config, **parse_flags(flags))
    out = settings.trial.out
    with LiveLine(settings.network.swarm, enabled=not quiet) as line:
        _live(run_watch(settings, None if out is None else Path(out) / RECORD_NAME, line.update))


def mission(
    changes: Annotated[
        list[str],
        typer.Option("--set", help="What is to change, such as shape=square; may repeat", metavar="FIELD=VALUE"),
    ],
    robot_id: Annotated[
        int | None, typer.Option("--id", min=0, help="Robot to give it to [any that is there]", show_default=False)
    ] = None,
    config: ConfigPath = None,
    connect: Annotated[str | None, typer.Option(help="Endpoint of a peer of the swarm [the configuration's]")] = None,
    swarm_name: Annotated[str | None, typer.Option("--swarm", help="Name of the swarm [the configuration's]")] = None,
) -> None:
    """Give a running swarm another mission: one robot is told, the others hear of it from there."""
    from llm_flock.runtime.network.watch import give_mission

    settings = load_config_of(SwarmConfig, config, connect=connect, swarm=swarm_name)
    fields = dict(_change(text) for text in changes)
    settings.mission.change(**fields)  # what is not allowed is said here, and not only noted by a robot
    taker = asyncio.run(give_mission(settings, fields, robot_id))
    if taker is None:
        raise InputError("connect", settings.network.connect, "where a swarm runs; nobody was there")
    print(f"given to robot {taker}")


def _change(text: str) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    if not equals:
        raise InputError("set", text, "FIELD=VALUE")
    try:
        return field, json.loads(f"[{value}]" if field == "center" and "[" not in value else value)
    except ValueError:
        return field, value
