"""Commands of swarms in which each robot is a process: robot, world, swarm, watch and mission."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Coroutine
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli.display import live_line
from llm_flock.cli.options import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    SET_BY_SWARM,
    ConfigPath,
    JsonOutput,
    Quiet,
    Record,
    parse_flags,
    with_config_flags,
    with_output_folder,
)
from llm_flock.cli.terminal import Screen, say
from llm_flock.errors import InputError
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.process import run

WITHOUT_OUT = SET_BY_SWARM | {"out"}


def _run_until_stopped(work: Coroutine[Any, Any, None]) -> None:
    try:
        run(work)
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_INTERRUPTED) from None


@with_config_flags(without=WITHOUT_OUT, kind=SwarmConfig)
def robot(
    robot_id: Annotated[int, typer.Option("--id", min=0, help="Id of this robot in the swarm")],
    config: ConfigPath = None,
    **flags: Any,
) -> None:
    """Run one robot of a swarm until the process is stopped."""
    from llm_flock.runtime.network.robot import run_robot

    _run_until_stopped(run_robot(SwarmConfig.load(config, **parse_flags(flags)), robot_id))


@with_config_flags(without=WITHOUT_OUT, kind=SwarmConfig)
def world(config: ConfigPath = None, **flags: Any) -> None:
    """Simulate the bodies and sensors of a swarm. Listens where the robots connect."""
    from llm_flock.runtime.network.swarm import world_config
    from llm_flock.runtime.network.world import run_world

    settings = world_config(SwarmConfig.load(config, **parse_flags(flags)))
    listens = f"the world listens on {settings.network.listen}"
    _run_until_stopped(run_world(settings, lambda: say(listens, error=True)))


@with_config_flags(without=SET_BY_SWARM, kind=SwarmConfig)
def swarm(
    config: ConfigPath = None,
    json_output: JsonOutput = False,
    record: Record = True,
    quiet: Quiet = False,
    **flags: Any,
) -> None:
    """Fly one mission on this machine with a process for each robot, one for the world and one for the record."""
    from llm_flock.runtime.network.swarm import run_swarm

    settings = with_output_folder(SwarmConfig.load(config, **parse_flags(flags)), "swarm-", record=record)
    shape, n_robots = settings.mission.shape, settings.mission.n_robots
    bar, on_round = live_line(shape, enabled=not quiet and not json_output)
    try:
        with bar:
            result = asyncio.run(run_swarm(settings, on_round))
    except KeyboardInterrupt:
        say(f"interrupted; all {n_robots} robots have ended", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        say(json.dumps(result.to_dict(), allow_nan=False))
    else:
        simulated = " (simulated language models)" if result.simulated else ""
        title = escape(f"{shape}, {n_robots} robots, {settings.model.model}{simulated}")
        table = Table(title=title, show_header=False, title_justify="left")
        for key, value in result.to_dict().items():
            table.add_row(key.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
        Screen().print(table)
    if result.stopped == "no_plan":
        why = f"after {result.model_calls} calls; most often, {result.reason}"
        say(f"error: no robot has a plan, and no model gives an acceptable one, {why}", error=True)
    if result.crashed:
        say(f"error: {', '.join(result.crashed)} ended by a fault; the lines above say which", error=True)
    if result.crashed or not result.formed:
        raise typer.Exit(EXIT_FAILED)


@with_config_flags(without=SET_BY_SWARM, kind=SwarmConfig)
def watch(config: ConfigPath = None, quiet: Quiet = False, **flags: Any) -> None:
    """Watch a running swarm from outside, until Ctrl-C; with --out, record it."""
    from llm_flock.runtime.network.watch import run_watch

    settings = SwarmConfig.load(config, **parse_flags(flags))
    bar, on_round = live_line(settings.network.swarm, enabled=not quiet)
    with bar:
        _run_until_stopped(run_watch(settings, settings.record, on_round))


def mission(
    changes: Annotated[
        list[str],
        typer.Option("--set", help="Field to change, such as shape=square; repeat for more", metavar="FIELD=VALUE"),
    ],
    robot_id: Annotated[
        int | None, typer.Option("--id", min=0, help="Robot to give it to [any]", show_default=False)
    ] = None,
    config: ConfigPath = None,
    connect: Annotated[str | None, typer.Option(help="Endpoint of a peer of the swarm [the configuration's]")] = None,
    swarm_name: Annotated[str | None, typer.Option("--swarm", help="Name of the swarm [the configuration's]")] = None,
) -> None:
    """Give a running swarm another mission: one robot receives it and passes it on."""
    from llm_flock.runtime.network.watch import give_mission

    settings = SwarmConfig.load(config, connect=connect, swarm=swarm_name)
    fields = dict(_change(text) for text in changes)
    settings.mission.change(**fields)  # refused here with a message; a robot would only record the refusal
    taker = asyncio.run(give_mission(settings, fields, robot_id))
    if taker is None:
        raise InputError("connect", settings.network.connect, "where a swarm runs; nobody was there")
    say(f"given to robot {taker}")


def _change(text: str) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    if not equals:
        raise InputError("set", text, "FIELD=VALUE")
    try:
        return field, json.loads(f"[{value}]" if field == "center" and "[" not in value else value)
    except ValueError:
        return field, value
