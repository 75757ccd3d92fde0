"""Commands of swarms in which each robot is a process: robot, world, swarm, watch and mission."""

from __future__ import annotations

import json
import signal
import socket
from collections.abc import Coroutine, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    ConfigPath,
    Edit,
    Extension,
    Finding,
    JsonOutput,
    Quiet,
    ReaderModel,
    Record,
    Screen,
    Words,
    Yes,
    chosen,
    confirmed_draft,
    extended,
    live_line,
    needed,
    say,
    showing,
    with_config_flags,
    with_output_folder,
)
from llm_flock.errors import InputError
from llm_flock.extras import require, require_posix
from llm_flock.printable import shape_title
from llm_flock.record import rules_text

if TYPE_CHECKING:
    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._network.swarm import SwarmResult

BAG = "bag"  # folder of a bag
ROUTER = "tcp/127.0.0.1:7447"  # where a swarm's peers find each other unless the configuration says otherwise
PATIENCE_S = 2.0  # longest wait for a router [s]

NOBODY = "no swarm answers there; `robot` and `swarm` take the same --connect and --swarm"

NOT_FORMED = "[bold red]no[/]"

SWARM = "llm_flock_swarm._network.config:SwarmConfig"

SHOWN = ("shape", "n_robots", "model", "base_url", "swarm", "listen", "connect", "keys")
"""Fields that the help of each command lists."""

NOT_IN_SWARMS = (
    *("kill", "join", "kill_random", "join_random", "changes"),
    *("noise", "drift", "sensing_delay", "moving_obstacles", "velocity", "rounds", "relay", "collision_check"),
)
"""Fields of runs that swarms of processes do not support."""

BODIES_ELSEWHERE = (*NOT_IN_SWARMS, "ros_poses", "ros_pose_topic")
"""Fields without a meaning where another process has the robots' bodies and sensors, too."""


def _load(config: Path | None, flags: Mapping[str, Any]) -> SwarmConfig:
    """The configuration of a command that may show its team in ROS 2; no flag of ROS 2 goes without --ros2."""
    from llm_flock.runtime import refuse_ros2
    from llm_flock_swarm._network.config import SwarmConfig

    settings = SwarmConfig.load(config, **flags)
    if settings.ros2.router is None:
        refuse_ros2(flags, "has no effect without --ros2")
    return settings


def _run_until_stopped(work: Coroutine[Any, Any, None]) -> None:
    from llm_flock_swarm._network.process import run

    try:
        run(work)
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_INTERRUPTED) from None


@with_config_flags(SWARM, shown=SHOWN, without=(*NOT_IN_SWARMS, "out", "[ros2]"))
def robot(
    robot_id: Annotated[int, typer.Option("--id", min=0, help="Id of this robot in the swarm")],
    config: ConfigPath = None,
    **flags: Any,
) -> None:
    """Run one robot of a swarm until the process is stopped."""
    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._network.robot import run_robot

    _run_until_stopped(run_robot(SwarmConfig.load(config, **flags), robot_id))


@with_config_flags(SWARM, shown=SHOWN, without=(*NOT_IN_SWARMS, "out", "[ros2]"))
def world(config: ConfigPath = None, **flags: Any) -> None:
    """Simulate the bodies and sensors of a swarm. Listens where the robots connect."""
    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._network.swarm import world_config
    from llm_flock_swarm._network.world import run_world

    settings = world_config(SwarmConfig.load(config, **flags))
    listens = f"the world listens on {settings.network.listen}"
    _run_until_stopped(run_world(settings, lambda: say(listens, error=True)))


@with_config_flags(
    SWARM,
    shown=(*SHOWN, "protocol", "obstacles", "loss", "seed", "max_s", "out"),
    without=BODIES_ELSEWHERE,
)
@extended("sinks")
def swarm(
    config: ConfigPath = None,
    json_output: JsonOutput = False,
    record: Record = True,
    quiet: Quiet = False,
    *,
    extensions: list[Extension],
    **flags: Any,
) -> None:
    """Fly one mission on this machine with a process for each robot, one for the world and one for the record."""
    import asyncio

    sinks = chosen(extensions)
    require("network", "swarm")
    require_posix("swarm")
    from llm_flock_swarm._ros2.run import run_shown_swarm

    settings = _load(config, flags)
    settings = with_output_folder(settings, "swarm-", record=record, typed=flags.get("out"))
    if settings.record is not None:
        from llm_flock.record import check_new

        check_new(settings.record)  # the recorder is a process of its own, which would only fail once all have begun
    shape, n_robots = settings.mission.shape, settings.mission.n_robots
    waiting = f"starting {n_robots} robots, each a process ..."
    bar, on_round = live_line(shape, enabled=not quiet and not json_output, waiting=waiting)
    signal.signal(signal.SIGTERM, _like_ctrl_c)
    try:
        with showing(sinks, settings) as sink, ExitStack() as shown:
            flight = run_shown_swarm(settings, on_round, sink, on_launch=lambda: shown.enter_context(bar))
            result = asyncio.run(flight)
    except KeyboardInterrupt:
        say(f"interrupted; all {n_robots} robots have ended", error=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json_output:
        say(json.dumps(result.to_dict(), allow_nan=False))
    else:
        Screen().show(_swarm_table(settings, result))
    if result.stopped == "no_plan":
        why = f"after {result.model_calls} calls; most often, {result.reason}"
        say(f"error: no robot has a plan, and no model gives an acceptable one, {why}", error=True)
    if result.crashed:
        say(f"error: {', '.join(result.crashed)} ended by a fault; the lines above say which", error=True)
    if result.crashed or not result.formed:
        raise typer.Exit(EXIT_FAILED)


def _like_ctrl_c(number: int, frame: FrameType | None) -> None:
    """End every process and keep the record, which the death of this process alone would not do."""
    signal.raise_signal(signal.SIGINT)


def _swarm_table(settings: SwarmConfig, result: SwarmResult) -> Table:
    """The result of a swarm, in words and numbers."""
    rules = settings.protocol
    simulated = " (simulated language models)" if result.simulated else ""
    title = escape(
        f"{shape_title(settings.mission.shape)}, {result.n_robots} robots, {settings.model.model}{simulated}"
    )
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="dim")
    table.add_column()
    p50, p99, latency = result.latency_p50_s, result.latency_p99_s, "not known"
    if p50 is not None and p99 is not None:
        latency = f"median {1000 * p50:.1f} ms, 99th percentile {1000 * p99:.1f} ms"
    not_formed = "not known" if result.formed is None else NOT_FORMED
    plan = f"robot {result.plan_robot}, by {result.plan_by}" if result.plan_robot is not None else "none in force"
    separation, mission = result.min_separation, settings.mission
    rows = [
        ("protocol", rules_text(rules.consensus, rules.assignment, shield=rules.shield)),
        ("formed", f"[bold green]yes[/], after {result.mission_s or 0.0:.1f} s" if result.formed else not_formed),
        ("stopped", result.stopped),
        ("plan", escape(plan)),
        ("smallest separation", f"{separation:.3f} (safe distance {mission.safe_distance:g}){mission.by_height}"),
        ("waypoints", ", ".join(f"{n} {who}" for who, n in result.waypoints.items() if n) or "none"),
        ("model calls", f"{result.model_calls} ({result.calls_failed} failed)"),
        ("tokens", f"{result.tokens:,}"),
        ("messages", f"{result.bytes_per_robot_s:,.0f} bytes per robot and second"),
        ("latency", latency),
    ]
    special = [
        ("late commands", str(result.late_commands or "")),
        ("breakers opened", ", ".join(f"robot {robot}" for robot in result.breakers_opened)),
        ("rejected", ", ".join(f"{n} {why}" for why, n in result.messages_rejected.items())),
        ("shown to lie", ", ".join(f"robot {robot}: {why}" for robot, why in result.shown_to_lie.items())),
        ("ended", ", ".join(f"{name} ({code})" for name, code in result.ended.items())),
        ("gave up", ", ".join(f"{part} ({why})" for part, why in result.gave_up.items())),
        ("record", result.record or ""),
    ]
    for name, value in rows + [(name, escape(value)) for name, value in special if value]:
        table.add_row(name, value)
    return table


@with_config_flags(SWARM, shown=(*SHOWN, "router", "out"), without=BODIES_ELSEWHERE)
@extended("sinks")
def watch(
    config: ConfigPath = None,
    quiet: Quiet = False,
    *,
    extensions: list[Extension],
    **flags: Any,
) -> None:
    """Watch a running swarm from outside, until Ctrl-C; with --out, record it."""
    from llm_flock_swarm._ros2.run import run_bridge

    sinks = chosen(extensions)
    settings = _load(config, flags)
    where = f" at {settings.network.connect}" if settings.network.connect else ""
    waiting = f"waiting for robots of swarm {settings.network.swarm!r}{where} ..."
    bar, on_round = live_line(settings.network.swarm, enabled=not quiet, waiting=waiting)
    with showing(sinks, settings) as sink, bar:
        _run_until_stopped(run_bridge(settings, settings.record, on_round, sink))


@with_config_flags(SWARM, shown=(*SHOWN, "router", "ros_missions", "ros_poses", "unit_m", "out"), without=NOT_IN_SWARMS)
def ros2(config: ConfigPath = None, quiet: Quiet = False, **flags: Any) -> None:
    """Show a running swarm as nodes of ROS 2, until Ctrl-C, and take missions and poses from there; no ROS is needed.

    With --ros-poses this is the swarm's world: start it in place of `llm-flock world`.
    """
    require("network", "ros2")
    require("ros2", "ros2")
    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._ros2.bridge import with_router
    from llm_flock_swarm._ros2.run import run_bridge

    settings = with_router(SwarmConfig.load(config, **flags))
    bar, on_round = live_line(settings.network.swarm, enabled=not quiet)
    with bar:
        _run_until_stopped(run_bridge(settings, settings.record, on_round))


def mission(
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Field to change, such as shape=square; repeat for more", metavar="FIELD=VALUE"),
    ] = None,
    words: Words = None,
    edit: Edit = None,
    reader: ReaderModel = None,
    yes: Yes = False,
    proceed: Annotated[bool, typer.Option("--next", help="Go on to the next stage of the mission")] = False,
    robot_id: Annotated[
        int | None, typer.Option("--id", min=0, help="Robot to give it to [any]", show_default=False)
    ] = None,
    config: ConfigPath = None,
    connect: Annotated[str | None, typer.Option(help="Endpoint of a peer of the swarm [the configuration's]")] = None,
    swarm_name: Annotated[str | None, typer.Option("--swarm", help="Name of the swarm [the configuration's]")] = None,
) -> None:
    """Give a running swarm another mission: one robot (with keys one more than may lie) passes it on."""
    import asyncio

    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._network.watch import give_mission, present_mission

    fields = dict(_change(text) for text in changes or ())
    settings = SwarmConfig.load(config, connect=connect, swarm=swarm_name)
    if [bool(fields), words is not None, edit is not None, proceed].count(True) != 1:
        raise InputError("set", changes, says="one of --set, --words, --edit and --next")
    if not fields:
        now = asyncio.run(present_mission(settings))
        if now is None:
            says = f"no swarm of {settings.mission.n_robots} robots tells its mission there; give its --config, too"
            raise InputError("connect", settings.network.connect or None, says=says)
        settings = settings.flying(now)
        if proceed:
            fields = now.proceeding()
        else:
            fields = dict(confirmed_draft(settings, words, edit, reader, yes=yes, flying=True).fields)
    settings.mission.change(**fields)  # refused here with a message; a robot would only record the refusal
    takers = asyncio.run(give_mission(settings, fields, robot_id))
    if not takers and robot_id is not None:
        raise InputError("id", robot_id, says="no such robot answers there")
    if not takers:
        raise InputError("connect", settings.network.connect or None, says=NOBODY)
    say("given to robot " + " and robot ".join(map(str, takers)))


def keys(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder", show_default=False)],
    robots: Annotated[int, typer.Option(min=1, help="Number of robots", show_default=False)],
    days: Annotated[int, typer.Option(min=1, help="Validity of the certificates [days]")] = 365,
) -> None:
    """Make the keys and certificates of a team whose robots are separate processes.

    No file is overwritten. Each robot gets a folder: its machine needs that folder, team.json and ca.pem.
    """
    require("network", "keys")
    from llm_flock_swarm._trust.keys import make_keys

    make_keys(folder, robots, days=days)
    say(f"keys of {robots} robots, operator, world and watcher in {folder}; keep {folder / 'authority'} offline")


def export_bag(
    record: Path | None,
    folder: Path,
    *,
    ros2bag: Annotated[
        bool, typer.Option("--ros2bag", help="Write a record as a bag of ROS 2 (MCAP), to a folder `bag`")
    ] = False,
    unit_m: Annotated[
        float | None,
        typer.Option(help="With --ros2bag: length of one mission unit [m] [1, or the flight's]", show_default=False),
    ] = None,
) -> Iterator[Path]:
    """Write a record as a bag; gives the path of the bag."""
    require("ros2", "export --ros2bag")

    from llm_flock.runtime import Ros2Config
    from llm_flock.validation import checked
    from llm_flock_swarm._ros2.bag import write_bag

    config = checked(Ros2Config, {"unit_m": unit_m})
    yield write_bag(needed(record), folder / BAG, config)


def reach_router(
    *, router: Annotated[str, typer.Option(help="Endpoint of a swarm's router or peer to reach")] = ROUTER
) -> list[Finding]:
    """The line of `llm-flock doctor` about a swarm's endpoint: whether a process listens there."""
    host, colon, port = router.partition("/")[2].rpartition(":")
    name = f"router at {router}"
    if not colon or not port.isdigit() or not host or int(port) > 65535:
        return [Finding("reach", name, False, "not an endpoint such as tcp/127.0.0.1:7447")]
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE_S).close()
    except OSError as error:
        return [Finding("reach", name, False, f"{error.strerror or error}; llm-flock swarm needs none")]
    return [Finding("reach", name, True, "something listens there")]


def _change(text: str) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    if not equals:
        raise InputError("set", text, "FIELD=VALUE")
    try:
        return field, json.loads(f"[{value}]" if field == "center" and "[" not in value else value)
    except ValueError:
        return field, value
