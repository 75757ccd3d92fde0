"""Faults of a flight on stand-in autopilots: what becomes of it, and the time until everybody is down or safe.

    python -m benchmarks autopilot-faults --csv docs/data/autopilot-faults.csv    all, once each
    python -m benchmarks autopilot-faults loiter killed                           some, by name

The shipped example, square of four, by stand-ins with ArduCopter's traits. The fault comes in the middle of a round, to
the second vehicle. Distances are those of the stand-ins' own positions.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import csv
import itertools
import json
import math
import os
import signal
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.autopilots import STARTS, example
from benchmarks.flight import yes
from benchmarks.flight_cases import flying

from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._mavlink.frames import Geodetic
from llm_flock_flight._testing.mavlink import AutopilotStandIn, AutopilotStandIns

AFTER_S = 2.5  # from the start of the first round to the fault [s]
BOOT_S = 3.0  # silence of an autopilot that reboots [s]
LINGER_S = 25.0  # longest wait after a flight for a vehicle that its own failsafe still lands [s]
WORLD = Geodetic(latitude_deg=47.397, longitude_deg=8.545, altitude_m=488.0)
METRES_PER_DEGREE = 111_195.0  # along a meridian
NO_GPS = (4, "PreArm: GPS 1: Bad fix")


class Watch:
    """Looks at the bodies: their smallest distance in the air, and when everybody, or everybody else, was down."""

    def __init__(self, stand_ins: AutopilotStandIns) -> None:
        self._vehicles = [stand_ins[k] for k in range(len(stand_ins))]
        self.nearest_m, self.down_s = math.inf, [0.0] * len(stand_ins)
        self.all_down = asyncio.Event()

    async def look(self) -> None:
        """Until cancelled."""
        while True:
            now, places = time.monotonic(), [vehicle.position for vehicle in self._vehicles]
            aloft = [z > 0.05 or vehicle.armed for (_, _, z), vehicle in zip(places, self._vehicles, strict=True)]
            for k, up in enumerate(aloft):
                self.down_s[k] = math.inf if up else min(self.down_s[k], now)
            self.all_down.clear() if any(aloft) else self.all_down.set()
            for (a, one), (b, two) in itertools.combinations(zip(aloft, places, strict=True), 2):
                if a and b:
                    self.nearest_m = min(self.nearest_m, math.dist(one, two))
            await asyncio.sleep(0.02)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What happens, in words, to the second vehicle in flight (`act`) or to all before it (`prepare`)."""

    title: str
    does: str
    act: Callable[[AutopilotStandIn], Awaitable[None] | None] | None = None
    prepare: Callable[[AutopilotStandIns], None] = lambda stand_ins: None
    fields: dict[str, Any] | None = None
    signals: tuple[signal.Signals, ...] = ()


def _switch(mode: str) -> Callable[[AutopilotStandIn], None]:
    return lambda vehicle: vehicle.switch(mode)


async def _reboot(vehicle: AutopilotStandIn) -> None:
    vehicle.die()
    await asyncio.sleep(BOOT_S)
    vehicle.silent = False


def _lose_radio(vehicle: AutopilotStandIn) -> None:
    with vehicle.lock:
        vehicle.autopilot.lose_radio()


def _all(stand_ins: AutopilotStandIns, change: Callable[[AutopilotStandIn, int], None]) -> None:
    for k in range(len(stand_ins)):
        change(stand_ins[k], k)


def _give_origin(vehicle: AutopilotStandIn, k: int) -> None:
    (east, north), scale = STARTS[k], math.cos(math.radians(WORLD.latitude_deg))
    latitude = WORLD.latitude_deg + north / METRES_PER_DEGREE
    longitude = WORLD.longitude_deg + east / METRES_PER_DEGREE / scale
    vehicle.autopilot.origin = Geodetic(latitude_deg=latitude, longitude_deg=longitude, altitude_m=WORLD.altitude_m)


def _move_zero(stand_ins: AutopilotStandIns) -> None:
    stand_ins[1].autopilot.offset = (0.0, 0.0, -0.6)


def _refuse_arming(stand_ins: AutopilotStandIns) -> None:
    stand_ins[1].autopilot.refuse[400] = NO_GPS


def _blow(vehicle: AutopilotStandIn, _: int) -> None:
    vehicle.autopilot.body.wind = (3.0, 4.0, 0.0)


def _worsen(vehicle: AutopilotStandIn) -> None:
    vehicle.loss, vehicle.delay_s = 0.2, 0.3


def _lose_gps(stand_ins: AutopilotStandIns) -> None:
    stand_ins[1].autopilot.healthy = False


LAND, PILOT = "the others land", "the others land; it is left to its pilot"
FAULTS: dict[str, Fault] = {
    "loiter": Fault(title="Another ground station switches one to Loiter", does=PILOT, act=_switch("Loiter")),
    "rtl": Fault(
        title="Another ground station switches one to RTL",
        does=f"{LAND}; its failsafe lands it once the flight's heartbeats end",
        act=_switch("RTL"),
    ),
    "land": Fault(title="Another ground station switches one to Land", does=f"{LAND}, too", act=_switch("Land")),
    "radio": Fault(title="One loses its radio control", does=f"its failsafe lands it; {LAND}", act=_lose_radio),
    "ends": Fault(title="One autopilot ends", does=f"it falls; {LAND}", act=AutopilotStandIn.die),
    "reboots": Fault(title="One autopilot reboots in the air", does=f"it falls; {LAND}", act=_reboot),
    "arming": Fault(title="One refuses to arm (no GPS)", does=f"{LAND} from where they are", prepare=_refuse_arming),
    "no_gps": Fault(title="One has no position", does="nothing takes off", prepare=_lose_gps),
    "origins": Fault(
        title="Each has an origin of its own, with `origin_lat_lon_alt`",
        does="the mission is flown",
        prepare=lambda stand_ins: _all(stand_ins, _give_origin),
        fields={"origin_lat_lon_alt": [WORLD.latitude_deg, WORLD.longitude_deg, WORLD.altitude_m]},
    ),
    "homes": Fault(title="One's zero is 0.6 m below the others'", does="nothing takes off", prepare=_move_zero),
    "wind": Fault(
        title="A wind of 5 m/s", does="the mission is flown", prepare=lambda stand_ins: _all(stand_ins, _blow)
    ),
    "link": Fault(title="One link loses 20 %, and delays by 300 ms each way", does="the mission is flown", act=_worsen),
    "ctrl_c": Fault(title="Ctrl-C once", does="all land", signals=(signal.SIGINT,)),
    "ctrl_c_twice": Fault(title="Ctrl-C twice", does="all motors are cut", signals=(signal.SIGINT, signal.SIGINT)),
    "killed": Fault(title="The flight process is killed", does="the deadman lands all", signals=(signal.SIGKILL,)),
}


async def fly(name: str) -> dict[str, Any]:
    """One flight with one fault; its row."""
    fault = FAULTS[name]
    homes = [(x, y, 0.0) for x, y in STARTS[:4]]
    with AutopilotStandIns(homes, flavour="ardupilot", lifelike=True) as stand_ins:
        fault.prepare(stand_ins)
        config, watch = example(stand_ins.uris, **(fault.fields or {})), Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        run = _run_command if fault.signals else _run_here
        began_s, ended, ends = await run(config, fault, stand_ins)
        await asyncio.sleep(0.1)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(watch.all_down.wait(), 0.1 if name == "loiter" else LINGER_S)
        looking.cancel()
        others = [watch.down_s[k] for k in range(4) if k != 1 or fault.act is None]
        flown = watch.nearest_m < math.inf
        safe = others if name == "loiter" else watch.down_s
        return {
            "Name": name,
            "Fault": fault.title,
            "What is done": fault.does,
            "Ended": ended,
            "In the end": ends or f"{sum(down < math.inf for down in watch.down_s)} landed",
            "Others down [s]": round(max(others) - began_s, 1) if flown and began_s else "",
            "All down or safe [s]": round(max(safe) - began_s, 1) if flown and began_s else "",
            "Smallest distance [m]": round(watch.nearest_m, 2) if flown else "",
        }


def _told(ends: Sequence[str]) -> str:
    return ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(ends))


async def _run_here(config: FlightConfig, fault: Fault, stand_ins: AutopilotStandIns) -> tuple[float, str, str]:
    """Fly in this process; the time of the fault, the flight's end, and the drones' ends."""
    flying, began_s = asyncio.Event(), 0.0

    def on_stage(stage: str) -> None:
        nonlocal began_s
        if stage == "flying":
            flying.set()
        if stage == "landing" and not flying.is_set():
            began_s = time.monotonic()  # take-off was refused

    task = asyncio.create_task(Flight(config, build_fleet(config), on_stage=on_stage).run(yes))
    flown = asyncio.create_task(flying.wait())
    await asyncio.wait((task, flown), return_when=asyncio.FIRST_COMPLETED)
    if flying.is_set() and fault.act is not None:
        await asyncio.sleep(AFTER_S)
        began_s = time.monotonic()
        done = fault.act(stand_ins[1])
        if done is not None:
            await done
    result = await task
    flown.cancel()
    if result.result is None:
        failed = [str(check) for check in result.report.checks if not check.passed]
        return 0.0, f"preflight: {'; '.join(failed)}".partition(" at udp")[0], "4 never took off"
    figures = result.result.summary.flight
    assert figures is not None
    ended = figures.ended if figures.reason is None else f"{figures.ended}: {figures.reason}"
    return began_s, ended, _told(list(figures.ends.values()))


async def _run_command(config: FlightConfig, fault: Fault, stand_ins: AutopilotStandIns) -> tuple[float, str, str]:
    """Fly by the command `fly` in a process of its own, and send it signals."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.json"
        file.write_text(config.model_dump_json(exclude_none=True), encoding="utf-8")
        code = (
            "import asyncio, json, sys; from benchmarks.autopilot_faults import *\n"
            "from llm_flock_flight._cli.keyboard import Keyboard\n"
            "config = FlightConfig.model_validate_json(open(sys.argv[1]).read())\n"
            "flight = Flight(config, build_fleet(config), on_stage=lambda stage: print(stage, flush=True))\n"
            "async def main():\n"
            "    with Keyboard(flight) as keyboard:\n"
            "        done = await flight.run(yes)\n"
            "    if done.result is None:\n"
            "        sys.exit(str([str(check) for check in done.report.checks if not check.passed]))\n"
            "    found = done.result.summary.flight\n"
            "    print(json.dumps([found.ended, found.reason, list(found.ends.values())]), flush=True)\n"
            "asyncio.run(main())"
        )
        process = await flying(code, file)
        assert process.stdout is not None
        await asyncio.sleep(AFTER_S)
        if process.returncode is not None:
            raise SystemExit("the flight did not take off")
        began_s = time.monotonic()
        for number in fault.signals:
            os.kill(process.pid, number)
            await asyncio.sleep(0.3)
        last = b""
        async for line in process.stdout:
            last = line
        await process.wait()
    if not last.startswith(b"["):
        return began_s, "killed", ""
    ended, reason, ends = json.loads(last)
    return began_s, f"{ended}: {reason}", _told(ends)


def write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write the rows of a table, or replace those of these faults, in the order of `FAULTS`."""
    table = {row["Name"]: row for row in rows}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            table = {row["Name"]: row for row in csv.DictReader(file)} | table
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(table.values(), key=lambda row: list(FAULTS).index(row["Name"])))


def faults() -> None:
    """Every fault ends with everybody down or safe."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """Read the options, fly, and print a line of JSON of each fault."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks autopilot-faults")
    parser.add_argument("faults", nargs="*", choices=[*FAULTS, []], help="names; none: all")
    parser.add_argument("--csv", type=Path, help="file to write, or whose rows of these faults to replace")
    given = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    for name in given.faults or FAULTS:
        rows.append(asyncio.run(fly(name)))
        print(json.dumps(rows[-1]), flush=True)
    if given.csv:
        write(given.csv, rows)
