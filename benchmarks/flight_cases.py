"""Every failure that a flight of stand-ins must survive, once each: the reaction, its stated and its measured time.

    python -m benchmarks flight-cases               all
    python -m benchmarks flight-cases radio_pause   some, by name; a line of JSON each
    python -m benchmarks flight-cases --write       and writes what was measured to docs/data/flight-cases.csv

Stand-ins have the stock PID controller unless `--controller` says otherwise.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import csv
import json
import math
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.flight import Watch, addressed, flight_config, yes

from llm_flock.robots._base import Position
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._flight.timed_planner import TimedPlanner
from llm_flock_flight._testing.crtp import StandIn, StandIns
from llm_flock_flight._testing.poses import PoseStream

FAST: dict[str, Any] = {"take_off_group": 4, "take_off_s": 2.5, "round_s": 2.5, "land_s": 2.5, "connect_s": 10.0}
"""As fast as the stock controller allows: it follows at most 1 m/s."""


def case_config(shape: str, n: int, seed: int, **fields: Any) -> tuple[FlightConfig, list[Position]]:
    """The flight in which something happens."""
    return flight_config(shape, n, seed, **{**FAST, "deadman": True, "reach_s": 8.0, "think_s": 2.0, **fields})


TABLE = Path(__file__).parents[1] / "docs" / "data" / "flight-cases.csv"
"""What each case is, the time stated, and what was measured."""

HOVER_S = 10.0
"""Time for which drones are watched that nobody will land [s]."""

DEADMAN_S = 3.0
"""Time for the deadman to hear that the stand-ins are down [s]."""


@dataclass
class Scene:
    """A flight in the middle of which something fails."""

    flight: Flight
    stand_ins: StandIns
    config: FlightConfig
    poses: PoseStream | None = None

    @property
    def victim(self) -> StandIn:
        """The drone that fails."""
        return self.stand_ins[1]

    @property
    def cameras(self) -> PoseStream:
        """The motion capture of a flight that has one."""
        assert self.poses is not None
        return self.poses


async def _pause(scene: Scene, seconds: float) -> float:
    scene.victim.lose_link()
    await asyncio.sleep(seconds)
    scene.victim.lose_link(False)
    return time.monotonic()


async def _at_once(act: Callable[[], object]) -> float:
    act()
    return time.monotonic()


def _believe_to_be_at(scene: Scene, x_m: float) -> None:
    """Shift its estimate far to the left: the drone flies off to the right, away from the others."""
    scene.victim.jump((x_m - scene.victim.position[0], 0.0, 0.0))


def _next_to_another(scene: Scene) -> None:
    (ax, ay, _), (bx, by, _) = scene.victim.position, scene.stand_ins[0].position
    scene.victim.jump((bx - ax + 0.1, by - ay, 0.0))


def _set(poses: PoseStream, **faults: Any) -> None:
    for name, value in faults.items():
        setattr(poses, name, value)


OTHER_DRONE, VICTIM = "cf0", "cf1"
"""Names of the first two drones."""

OUTSIDE = frozenset({"pose_lost", "pose_frozen", "markers_swapped"})
"""Cases in which the drones get their positions from outside."""

NOISE_M = 0.001
"""Noise of their motion capture, which sends a hundred frames a second [m]."""

CASES: dict[str, Callable[[Scene], Awaitable[float]]] = {
    "link_returns": lambda scene: _pause(scene, 3.0),
    "radio_pause": lambda scene: _pause(scene, 2.0),
    "link_gone": lambda scene: _at_once(scene.victim.lose_link),
    "estimate_jumps": lambda scene: _at_once(lambda: scene.victim.jump((0.5, 0.4, 0.0))),
    "estimate_stalls": lambda scene: _at_once(scene.victim.stall),
    "estimate_stops": lambda scene: _at_once(scene.victim.mute_log),
    "battery_low": lambda scene: _at_once(lambda: scene.victim.set_battery(3.0)),
    "controller_changes": lambda scene: _at_once(lambda: scene.victim.set_parameter(CONTROLLER, OTHER)),
    "drones_swapped": lambda scene: _at_once(lambda: scene.stand_ins.swap(0, 1)),
    "tumbles": lambda scene: _at_once(scene.victim.tumble),
    "geofence": lambda scene: _at_once(lambda: _believe_to_be_at(scene, -9.0)),
    "far_outside": lambda scene: _at_once(lambda: _believe_to_be_at(scene, -12.0)),
    "too_near": lambda scene: _at_once(lambda: _next_to_another(scene)),
    "pose_lost": lambda scene: _at_once(lambda: _set(scene.cameras, hidden=frozenset({VICTIM}))),
    "pose_frozen": lambda scene: _at_once(lambda: _set(scene.cameras, frozen=frozenset({VICTIM}))),
    "markers_swapped": lambda scene: _at_once(lambda: _set(scene.cameras, swapped=(OTHER_DRONE, VICTIM))),
    "abort": lambda scene: _at_once(scene.flight.abort),
    "emergency": lambda scene: _at_once(scene.flight.emergency),
}
"""Each causes a failure, and returns the moment from which its time counts."""


ALL = (*CASES, "model_silent", "controller_unknown", "radio_second", "power_lost", "killed", "hangs")

CONTROLLER = "stabilizer.controller"
OTHER, UNKNOWN = 2, 9
"""Mellinger's controller, and one that no firmware has."""


async def fly_case(name: str, after_s: float = 1.5, **fields: Any) -> dict[str, Any]:
    """One flight with one failure; returns its outcome."""
    # Where a drone is where it should not be, because its estimate is wrong, the jump is not to be noticed first.
    jump_m = 100.0 if name in ("geofence", "far_outside", "too_near") else 0.3
    cut_outside_m = 10.0 if name == "geofence" else 1.0
    limits = {"jump_m": jump_m, "cut_outside_m": cut_outside_m}
    outside = {"pose_source": "udp", "pose_port": _free_port()} if name in OUTSIDE else {}
    config, homes = case_config("square", 4, 3, deadman=False, **limits, **outside, **fields)
    with StandIns(homes, outside=name in OUTSIDE) as stand_ins, contextlib.ExitStack() as stack:
        config = addressed(config, homes, stand_ins.uris)
        poses = stack.enter_context(_cameras(config, stand_ins)) if name in OUTSIDE else None
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        flight, flying = _flight(config)
        with _mute() if name == "model_silent" else contextlib.nullcontext():
            task = asyncio.create_task(flight.run(yes))
            await flying.wait()
            began = time.monotonic()
            if name != "model_silent":
                await asyncio.sleep(after_s)
                began = await CASES[name](Scene(flight, stand_ins, config, poses))
            result = await task
        await asyncio.sleep(0.1)
        looking.cancel()
        # A drone that hovers out of reach is as safe as it can be once everybody else is down and it is named.
        until = time.monotonic() - 0.1 if watch.all_off_s is None else watch.all_off_s
        return _row(name, result, until - began, watch.nearest_m)


def _flight(config: FlightConfig) -> tuple[Flight, asyncio.Event]:
    """A flight, and an event that is set once its mission begins."""
    flying = asyncio.Event()

    def on_stage(stage: str) -> None:
        if stage == "flying":
            flying.set()

    return Flight(config, build_fleet(config), on_stage=on_stage), flying


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def _cameras(config: FlightConfig, stand_ins: StandIns) -> PoseStream:
    """A motion capture that sees all stand-ins."""
    places = {drone.name: (lambda k=k: stand_ins[k].position) for k, drone in enumerate(config.fleet.drones)}
    return PoseStream(("127.0.0.1", config.positions.pose_port), places, noise_m=NOISE_M)


async def fly_through_a_pause(name: str, **fields: Any) -> dict[str, Any]:
    """A second without radio in mid-motion: the drone arrives, and the mission goes on to its end."""
    config, homes = case_config("square", 4, 3, deadman=False, **{"stall_s": 1.5, **fields})
    with StandIns(homes) as stand_ins:
        config = addressed(config, homes, stand_ins.uris)
        watch, victim = Watch(stand_ins), stand_ins[1]
        looking = asyncio.create_task(watch.look())
        flight, flying = _flight(config)
        task = asyncio.create_task(flight.run(yes))
        await flying.wait()
        await asyncio.sleep(1.0)
        began, sent = time.monotonic(), len(victim.firmware.commands)
        moved, (target, _, _) = victim.position, victim.firmware.body.set_point(began + 60.0)
        await _pause(Scene(flight, stand_ins, config), 1.0)
        assert len(victim.firmware.commands) == sent, "nothing reached it meanwhile"
        way_m, left_m = math.dist(moved, target), math.dist(victim.position, target)
        assert way_m > 2 * config.safety.tracking_m > 0.0 and left_m < way_m, "it was on its way, and flew on"
        for _ in range(1000):
            if math.dist(victim.position, target) <= config.safety.tracking_m:
                break
            await asyncio.sleep(0.01)
        took_s = time.monotonic() - began
        result = await task
        looking.cancel()
        row = _row(name, result, took_s, watch.nearest_m)
        assert row["ended"] == "mission", row
        return row


async def stay_on_the_floor(name: str) -> dict[str, Any]:
    """A drone whose controller nobody knows: no motor may turn."""
    config, homes = case_config("square", 4, 3, deadman=False)
    with StandIns(homes) as stand_ins:
        stand_ins[1].set_parameter(CONTROLLER, UNKNOWN)
        config = addressed(config, homes, stand_ins.uris)
        result = await Flight(config, build_fleet(config)).run(yes)
        flown = sum(len(stand_ins[k].firmware.commands) for k in range(len(stand_ins)))
    reason = "; ".join(str(check) for check in result.report.checks if not check.passed)
    ends = "4 never took off" if result.result is None and not flown else f"{flown} commands were sent"
    row = {"case": name, "ended": "preflight", "reason": reason, "ends": ends, "took_s": 0.0, "nearest_m": None}
    return row | _stated(name)


@contextlib.contextmanager
def _mute() -> Any:
    """Let no model answer."""
    plain = TimedPlanner._in_time  # noqa: SLF001

    async def mute(self: TimedPlanner, number: int, answer: Any) -> Any:
        answer.close()
        return await plain(self, number, asyncio.sleep(3600, None))

    TimedPlanner._in_time = mute  # noqa: SLF001
    try:
        yield
    finally:
        TimedPlanner._in_time = plain  # noqa: SLF001


def _row(name: str, result: FlightResult, took_s: float, nearest_m: float) -> dict[str, Any]:
    assert result.result is not None and result.result.summary.flight is not None
    found = result.result.summary.flight
    ends = list(found.ends.values())
    said = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(ends))
    return {
        "case": name,
        "ended": found.ended,
        "reason": found.reason,
        "ends": said,
        "took_s": took_s,
        "nearest_m": nearest_m,
    } | _stated(name)


def _stated(name: str) -> dict[str, Any]:
    """What the docs say of a case: what happens, what the flight does, and the time until every drone is safe [s]."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["Name"] == name)
    return {"what": row["Case"], "does": row["What is done"], "stated_s": float(row["Stated [s]"])}


async def flying(code: str, file: Path) -> asyncio.subprocess.Process:
    """A process that flies by this code and configuration file, once it says that it is flying."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", code, str(file), stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    async for line in process.stdout:
        if line.strip() == b"flying":
            break
    return process


async def fly_and_lose_the_process(name: str, **fields: Any) -> dict[str, Any]:
    """Kill or stop the flight process in the middle of a round; returns what the deadman does."""
    config, homes = case_config("square", 4, 3, **fields)
    with StandIns(homes) as stand_ins, tempfile.TemporaryDirectory() as folder:
        config = addressed(config, homes, stand_ins.uris)
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        file = Path(folder) / "flight.json"
        file.write_text(config.model_dump_json(exclude_none=True), encoding="utf-8")
        code = (
            "import asyncio, json, sys; from benchmarks.flight_cases import *;"
            "c = FlightConfig.model_validate_json(open(sys.argv[1]).read());"
            "asyncio.run(Flight(c, build_fleet(c), on_stage=lambda s: print(s, flush=True)).run(yes))"
        )
        process = await flying(code, file)
        await asyncio.sleep(1.5)
        watch.all_off.clear()
        began = time.monotonic()
        if name == "power_lost":
            for child in _children(process.pid):
                os.kill(child, signal.SIGKILL)
        os.kill(process.pid, signal.SIGSTOP if name == "hangs" else signal.SIGKILL)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(watch.all_off.wait(), HOVER_S if name == "power_lost" else 30.0)
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        await asyncio.sleep(DEADMAN_S)
        looking.cancel()
        places = [stand_ins[k].position for k in range(len(stand_ins))]
        landed = sum(z < 0.01 for _, _, z in places)
        took_s = (watch.all_off_s or float("inf")) - began
        motors = sum(stand_ins[k].flying for k in range(len(stand_ins)))
        ends = f"{landed} fell, {motors} hover" if name == "power_lost" else f"{landed} landed"
        row = {"case": name, "ended": name, "ends": ends, "took_s": took_s, "nearest_m": watch.nearest_m}
        return row | _stated(name)


def _children(pid: int) -> list[int]:
    """Processes that a process has started, as Linux tells: the deadman."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


def write_cases(rows: Sequence[dict[str, Any]]) -> None:
    """Write what was measured to the table, in the rows of these cases."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    for row in rows:
        nearest = "" if row["nearest_m"] is None else f"{row['nearest_m']:.2f}"
        measured = {"Measured [s]": f"{row['took_s']:.1f}", "In the end": row["ends"], "Smallest distance [m]": nearest}
        next(line for line in table if line["Name"] == row["case"]).update(measured)
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def show_cases(rows: Sequence[dict[str, Any]]) -> None:
    """The table of the safety cases (Markdown)."""
    print("\n| Name | Case | What is done | Stated [s] | Measured [s] | In the end | Smallest distance [m] |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['case']} | {row['what']} | {row['does']} | {row['stated_s']:.1f} | {row['took_s']:.1f} "
            f"| {row['ends']} | {'' if row['nearest_m'] is None else format(row['nearest_m'], '.2f')} |",
            flush=True,
        )


def case(name: str, **fields: Any) -> dict[str, Any]:
    """One case."""
    if name in ("killed", "hangs"):
        return asyncio.run(fly_and_lose_the_process(name, **fields))
    if name == "power_lost":
        return asyncio.run(fly_and_lose_the_process(name, **{"stop_watchdog": True, **fields}))
    if name == "radio_second":
        return asyncio.run(fly_through_a_pause(name, **fields))
    if name == "controller_unknown":
        return asyncio.run(stay_on_the_floor(name))
    return asyncio.run(fly_case(name, **fields))


def safety_cases() -> None:
    """Every case ends in a safe state in its stated time."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """All cases as a table, or some as JSON."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks flight-cases")
    parser.add_argument("cases", nargs="*", choices=[*ALL, []], help="names; none: all")
    parser.add_argument("--controller", help="controller that the flight file sets; else the stock one, PID")
    parser.add_argument("--write", action="store_true", help="write what was measured to docs/data/flight-cases.csv")
    given = parser.parse_args(arguments)
    fields: dict[str, Any] = {} if given.controller is None else {"controller": given.controller}
    rows: list[dict[str, Any]] = []
    for name in given.cases or ALL:
        rows.append(case(name, **fields))
        print(json.dumps(rows[-1]), file=sys.stdout if given.cases else sys.stderr, flush=True)
    if not given.cases:
        show_cases(rows)
    if given.write:
        write_cases(rows)
    late = [row["case"] for row in rows if row["took_s"] > row["stated_s"]]
    if late:
        sys.exit(f"not in the stated time: {', '.join(late)}")
