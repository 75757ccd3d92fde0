"""`llm-flock fly`: fly a mission with real drones, after a preflight and a confirmation; or as a dry run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    ConfigPath,
    Extension,
    Finding,
    JsonOutput,
    Quiet,
    Record,
    Screen,
    chosen,
    extended,
    live_line,
    refuse,
    say,
    showing,
    summary_table,
    while_shown,
    with_config_flags,
    with_output_folder,
)
from llm_flock.errors import FieldError
from llm_flock.extras import EXTRAS, require_posix
from llm_flock.printable import shape_title

if TYPE_CHECKING:
    from llm_flock.record import RecordSink
    from llm_flock.runtime import FlightFigures
    from llm_flock_flight._crazyflie.radios import RadioPlan
    from llm_flock_flight._flight.config import FlightConfig
    from llm_flock_flight._flight.dry_run import DryRun
    from llm_flock_flight._flight.flight import FlightResult
    from llm_flock_flight._flight.preflight import Check, PreflightReport

WORD = "fly"  # the word that confirms a flight


SHOWN = (
    *("shape", "n_robots", "center", "spacing", "model", "base_url", "rounds", "seed", "out"),
    *("robot", "drones", "crazyflies", "scale_m", "origin_m", "altitude_m", "geofence"),
    *("min_separation_m", "max_speed_m_s", "round_s", "at_end", "pose_source"),
)
"""Fields that `fly --help` lists."""

NOT_IN_FLIGHTS = (
    *("kill", "join", "battery", "kill_random", "join_random", "noise", "drift", "sensing_delay"),
    *("moving_obstacles", "start_positions"),
    *("unit_m", "use_sim_time", "ros_missions", "ros_poses"),
)
"""Fields of runs and swarms that flights do not support."""


@with_config_flags("llm_flock_flight._flight.config:FlightConfig", shown=SHOWN, without=NOT_IN_FLIGHTS)
@extended("sinks")
def fly(
    config: ConfigPath = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the whole flight with every set-point checked; call no drone")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Take off without asking, once the preflight is passed")] = False,
    json_output: JsonOutput = False,
    record: Record = True,
    quiet: Quiet = False,
    *,
    extensions: list[Extension],
    **flags: Any,
) -> None:
    """Fly one mission with drones: preflight, confirmation, take-off, flock, landing.

    In flight, r lets all drones return to their starts and land there, l (or Ctrl-C) lands them where they are, and
    x (or Ctrl-C twice) cuts all motors.
    """
    import asyncio

    from llm_flock.runtime import refuse_ros2
    from llm_flock_flight._flight.config import FlightConfig
    from llm_flock_flight._flight.fleet import with_drones

    sinks = chosen(extensions)
    if config is None and not dry_run and not (flags.get("drones") or flags.get("crazyflies")):
        says = "fly needs to know the drones: --config FILE, such as examples/flight.toml, or --crazyflies FILE"
        raise FieldError("config", says=f"{says} (--dry-run needs neither)")
    if not dry_run:
        require_posix("fly")
    if dry_run:
        refuse(sinks, "a dry run")
        refuse_ros2(flags, "has no effect in a dry run")
    settings = with_drones(FlightConfig.load(config, **flags))
    if settings.ros2.router is None:
        refuse_ros2(flags, "has no effect without --ros2")
    if dry_run:
        _dry_run(settings, json_output)
        return
    settings = with_output_folder(settings, "flight-", record=record, typed=flags.get("out"))
    with showing(sinks, settings) as sink:
        result = asyncio.run(_fly(settings, yes=yes, as_json=json_output, quiet=quiet, sink=sink))
    flown = result.result
    figures = None if flown is None else flown.summary.flight
    if json_output:
        say(json.dumps(_plain(result), allow_nan=False))
    elif flown is not None and figures is not None:
        Screen().show(summary_table(flown))
        Screen().show(_flight_table(figures))
    if result.broken_record is not None:
        say(f"error: the record broke off: {result.broken_record}", error=True)
        raise typer.Exit(EXIT_FAILED)
    if figures is None or not figures.safe or figures.ended != "mission":
        raise typer.Exit(EXIT_FAILED)


async def _fly(
    settings: FlightConfig, *, yes: bool, as_json: bool, quiet: bool, sink: RecordSink | None
) -> FlightResult:
    import asyncio

    from llm_flock.record import both
    from llm_flock_flight._cli.keyboard import Keyboard, ask
    from llm_flock_flight._flight.fleet import build_fleet
    from llm_flock_flight._flight.flight import Flight, Stage
    from llm_flock_flight._flight.shown import ros2_bridge

    async def confirm(report: PreflightReport) -> bool:
        if not as_json:
            Screen().show(_preflight_table(report.checks))
        if yes:
            return True
        answer = await ask(f"Type '{WORD}' to take off, anything else to stay: ")
        return answer.strip().lower() == WORD

    live = not quiet and not as_json

    def on_stage(stage: Stage) -> None:
        if stage == "taking off":  # until then the terminal belongs to the question
            keyboard.listen()
        if live:
            say(stage, error=True)
        if stage == "taking off":
            stack.enter_context(bar)

    def on_connect(check: Check) -> None:
        if live:
            waited.add(check.who)
            rest = [drone.name for drone in settings.fleet.drones if drone.name not in waited]
            still = f"; waiting for {', '.join(rest)}" if rest else ""
            say(f"{check.who}: {'connected in ' if check.passed else ''}{check.found}{still}", error=True)

    waited: set[str] = set()
    bar, on_round = live_line(shape_title(settings.mission.shape), enabled=live)
    async with AsyncExitStack() as stack:
        if settings.ros2.router is not None:
            names = [drone.name for drone in settings.fleet.drones]
            showing = ros2_bridge().showing_flight(settings.ros2, names, settings.frame, settings.safety.low_battery_v)
            sink = both(sink, await stack.enter_async_context(showing))
        fleet = build_fleet(settings)
        flight = Flight(
            settings,
            fleet,
            on_round=while_shown(on_round),
            on_stage=while_shown(on_stage),
            on_connect=while_shown(on_connect),
            sink=sink,
        )
        with Keyboard(flight) as keyboard:
            try:
                result = await flight.run(confirm)
            except asyncio.CancelledError:
                say("interrupted; nothing has taken off", error=True)
                raise typer.Exit(EXIT_INTERRUPTED) from None
    if not result.report.passed and not as_json:
        Screen().show(_preflight_table(result.report.checks))
        for check in result.report.checks:
            if not check.passed:
                say(f"error: {check}", error=True)
        say("error: the preflight was not passed; nothing has taken off", error=True)
    elif result.result is None:
        say("not confirmed; nothing has taken off", error=True)
    return result


def _dry_run(settings: FlightConfig, as_json: bool) -> None:
    import asyncio

    from llm_flock_flight._flight.dry_run import dry_run
    from llm_flock_flight._flight.preflight import radio_plan

    plan = asyncio.run(dry_run(settings))
    if as_json:
        say(json.dumps({**_plan(plan), **_radios(radio_plan(settings))}, allow_nan=False))
    else:
        for table in _plan_tables(settings, plan):
            Screen().show(table)
        for warning in radio_plan(settings).warnings:
            say(f"warning: {warning}", error=True)
        for fault in plan.faults:
            say(f"error: {fault}", error=True)
        if not plan.result.formed:
            say("warning: the formation is not formed", error=True)
        count = sum(len(motion.targets) for motion in plan.motions)
        say(f"{count} set-points, {plan.air_s:.0f} s in the air and more while models think, {len(plan.faults)} faults")
    if plan.faults:
        raise typer.Exit(EXIT_FAILED)


def _preflight_table(checks: Sequence[Check]) -> Table:
    from llm_flock_flight._flight.preflight import NAMES

    names = list(dict.fromkeys((*NAMES, *(check.name for check in checks))))
    table = Table("drone", *names, title="preflight", title_justify="left")
    found = {(check.who, check.name): check for check in checks}
    for who in dict.fromkeys(check.who for check in checks):
        table.add_row(escape(who), *(_cell(found.get((who, name))) for name in names))
    return table


def _cell(check: Check | None) -> str:
    if check is None:
        return ""
    return f"[green]{escape(check.found)}[/]" if check.passed else f"[bold red]{escape(check.found)}: FAILED[/]"


def _flight_table(found: FlightFigures) -> Table:
    table = Table(title="flight", show_header=False, title_justify="left")

    def length(value: float | None) -> str:
        return "not known" if value is None else f"{value:.3f} m"

    table.add_row("ended by", escape(found.ended if found.reason is None else f"{found.ended}: {found.reason}"))
    for name, end in found.ends.items():
        table.add_row(escape(name), end)
    table.add_row("in the air", f"{found.air_s:.1f} s")
    table.add_row("smallest distance", f"{length(found.min_separation_m)}, by the drones' own estimates")
    for reason, count in (found.poses_refused or {}).items():
        table.add_row("poses refused", f"{escape(reason)}, {count} times")
    table.add_row("off the set-points", f"rms {length(found.tracking_rms_m)}, at most {length(found.tracking_max_m)}")
    table.add_row("behind the set-points", f"at most {found.lag_s:.2f} s, all alike")
    return table


def _plan_tables(settings: FlightConfig, plan: DryRun) -> list[Table]:
    names = [drone.name for drone in plan.drones]
    group = settings.fleet.take_off_group
    rising = Table("group", "drone", r"from x, y \[m]", r"to z \[m]", title="take-off", title_justify="left")
    for robot, drone in enumerate(plan.drones):
        spot = "{:.2f}, {:.2f}".format(*(drone.start or (0.0, 0.0)))
        rising.add_row(str(1 + robot // group), escape(drone.name), spot, f"{settings.world.altitude_m:g}")
    way = Table("round", "drone", r"set-point \[m]", r"peak \[m/s]", r"nearest \[m]", "check", title="set-points")
    way.title_justify = "left"
    for motion in plan.motions:
        number, nearest = str(motion.round), f"{motion.separation_m:.3f}"
        check = "[bold red]FAULT[/]" if motion.faults else "[green]ok[/]"
        for name, (x, y, z), peak in zip(names, motion.targets, motion.peaks_m_s, strict=True):
            way.add_row(number, escape(name), f"{x:.3f}, {y:.3f}, {z:.3f}", f"{peak:.2f}", nearest, check)
            number = nearest = check = ""
    down = Table("group", "drone", r"spot x, y \[m]", r"by way of \[m]", title="landing", title_justify="left")
    for number, descents in enumerate(plan.landing, start=1):
        for descent in descents:
            via = "" if descent.via is None else "{:.2f}, {:.2f}, {:.2f}".format(*descent.via)
            down.add_row(str(number), escape(names[descent.robot]), "{:.2f}, {:.2f}".format(*descent.spot), via)
    return [*_radio_tables(settings), rising, way, down]


def _radio_tables(settings: FlightConfig) -> list[Table]:
    """The load of each radio; no table if no drone is called by radio."""
    from llm_flock_flight._flight.preflight import radio_plan

    table = Table(
        "radio", "channels", "drones", r"needed \[1/s]", r"can \[1/s]", "share", r"turn \[ms]", title="radios"
    )
    table.title_justify = "left"
    loads = radio_plan(settings).loads
    for load in loads:
        channels, drones = ", ".join(map(str, load.channels)), str(len(load.drones))
        rates = f"{load.needed_hz:.0f}", f"{load.capacity_hz:.0f}", f"{load.share:.0%}", f"{1000 * load.turn_s:.0f}"
        table.add_row(escape(load.dongle), channels, drones, *rates)
    return [table] if loads else []


def _radios(plan: RadioPlan) -> dict[str, Any]:
    return {
        "radios": [asdict(load) for load in plan.loads],
        "radio_warnings": plan.warnings,
    }


def _plan(plan: DryRun) -> dict[str, Any]:
    return {
        "drones": [drone.model_dump() for drone in plan.drones],
        "rounds": [
            {
                "round": motion.round,
                "targets_m": motion.targets,
                "peaks_m_s": motion.peaks_m_s,
                "separation_m": motion.separation_m if motion.separation_m < float("inf") else None,
                "faults": motion.faults,
            }
            for motion in plan.motions
        ],
        "landing": [[{"robot": d.robot, "spot_m": d.spot} for d in group] for group in plan.landing],
        "formed": plan.result.formed,
        "air_s": plan.air_s,
        "not_home": [plan.drones[robot].name for robot in plan.away_m],
        "faults": plan.faults,
    }


def _plain(result: FlightResult) -> dict[str, Any]:
    return {
        "preflight": {
            "passed": result.report.passed,
            "connect_s": result.report.connect_s,
            "failed": [str(c) for c in result.report.checks if not c.passed],
        },
        "summary": None if result.result is None else result.result.summary.to_dict(),
        "broken_record": None if result.broken_record is None else str(result.broken_record),
    }


NO_DRONE = "none answers, by radio at the address E7E7E7E7E7; llm-flock stand-ins simulates some"
"""Radios are searched on all channels for the address that drones are shipped with, not for others."""


def reach_drones(
    *,
    drones: Annotated[
        bool, typer.Option("--drones/--no-drones", help="Look for Crazyflies by radio, cable and UDP (a second)")
    ] = True,
) -> list[Finding]:
    """The line of `llm-flock doctor` about Crazyflies that answer."""
    if not drones:
        return []
    if EXTRAS["crazyflie"].missing:
        return [Finding("reach", "drone", False, "the extra crazyflie is not installed")]
    from llm_flock_flight._crazyflie.link import in_reach

    try:
        uris = in_reach()
    except Exception as error:  # noqa: BLE001  # drivers of radios raise anything, and this only looks
        return [Finding("reach", "drone", False, f"the search failed: {error}")]
    return [Finding("reach", "drone", bool(uris), ", ".join(uris) or NO_DRONE)]
