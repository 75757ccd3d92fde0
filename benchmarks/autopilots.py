"""The shipped flights, flown again and again by stand-ins: autopilots with ArduCopter's traits, PX4, and Crazyflies.

    python -m benchmarks autopilots --write                              all, and each limit halved once
    python -m benchmarks autopilots --write --drones crazyflie --only square --runs 20 --together 3

MAVLink: the example's own safety numbers, its starts and one more; only the drones take off together. Crazyflies: the
default flight file, random starts, the stock controller, through cflib. Tracking, delay and distances are those of the
stand-ins' own positions and of the set-points that reached them. `halved` has half of `tracking_m` and of
`off_course_s` in the monitors. `--write` replaces the rows of what was flown in docs/data/autopilot-flights.csv.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import itertools
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.flight import addressed, flight_config, yes
from numpy.typing import NDArray

from llm_flock.robots import Position
from llm_flock_flight._flight import monitors
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._mavlink.frames import enu
from llm_flock_flight._testing.crtp import StandIn, StandIns
from llm_flock_flight._testing.mavlink import AutopilotStandIn, AutopilotStandIns

ROOT = Path(__file__).parents[1]
EXAMPLE, TABLE = ROOT / "examples" / "flight_mavlink.toml", ROOT / "docs" / "data" / "autopilot-flights.csv"
STARTS = ((0.0, 0.0), (6.0, 0.0), (0.0, 6.0), (6.0, 6.0), (3.0, 3.0))
FLIGHTS = (("triangle", 3, False), ("cross", 5, False), ("circle", 5, False), ("square", 4, False), ("square", 4, True))
DRONES = {
    "ardupilot": "stand-ins for ArduPilot",
    "px4": "stand-ins for PX4",
    "crazyflie": "stand-ins for Crazyflies, PID",
}
NONE: Position = (math.nan, math.nan, math.nan)  # no set-point
FRESH_S = 0.2  # a set-point older than this is not followed any more [s]
LOOK_S = 0.025  # time between two looks at the bodies [s]
DELAYS, WINDOW = 41, 60  # delays that are tried, of `LOOK_S` each, and looks that have one delay
MOVES_M = 0.2  # set-points that move farther than this in a window tell its delay [m]


def example(uris: Sequence[str], **fields: Any) -> FlightConfig:
    """The shipped example for MAVLink, flown by stand-ins."""
    base = FlightConfig.load(EXAMPLE).model_dump(exclude_unset=True)
    drones = [{"name": f"v{k}", "uri": uri, "system_id": k + 1, "start": STARTS[k]} for k, uri in enumerate(uris)]
    given = {"n_robots": len(uris), "take_off_group": len(uris), **fields}
    return FlightConfig.build(base, drones=drones, **given)


def led(vehicle: AutopilotStandIn | StandIn, home: Position) -> tuple[bool, Position, Position]:
    """Whether it is in the air, where it is, and where its set-point is, not a number without one [m]."""
    if isinstance(vehicle, StandIn):
        return vehicle.flying, vehicle.position, vehicle.firmware.body.set_point(time.monotonic())[0]
    place = vehicle.position
    with vehicle.lock:
        mind = vehicle.autopilot
        stream, follows = mind._stream, mind.mode == mind.flavour.guided and mind.body.lifted  # noqa: SLF001
        fresh = stream is not None and follows and time.monotonic() - stream[1] < FRESH_S
        point = enu(mind.set_points[-1]) if fresh else NONE
    x, y, z = (a + b for a, b in zip(home, point, strict=True))
    return place[2] > 0.05, place, (x, y, z)


@dataclass(slots=True)
class Bodies:
    """Positions and set-points of all bodies, again and again: (looks, drones, 3) [m]; and their smallest distance."""

    times: list[float] = field(default_factory=list)
    places: list[list[Position]] = field(default_factory=list)
    points: list[list[Position]] = field(default_factory=list)
    nearest_m: float = math.inf

    async def look(self, vehicles: Sequence[AutopilotStandIn | StandIn], homes: Sequence[Position]) -> None:
        """Until cancelled."""
        due = time.monotonic()
        while True:
            looks = [led(vehicle, home) for vehicle, home in zip(vehicles, homes, strict=True)]
            for (up, here, _), (other_up, there, _) in itertools.combinations(looks, 2):
                if up and other_up:
                    self.nearest_m = min(self.nearest_m, math.dist(here, there))
            self.times.append(time.monotonic())
            self.places.append([place for _, place, _ in looks])
            self.points.append([point if up else NONE for up, _, point in looks])
            due = max(due + LOOK_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())

    def tracking(self) -> tuple[float, float, float]:
        """The longest delay of a window in which the set-points move [s], and the distances then: rms and largest [m].

        The delay of a window is that for which the team's distances from its set-points of then are least.
        """
        grid = np.arange(self.times[0], self.times[-1], LOOK_S)
        places, points = self._at(grid, self.places), self._at(grid, self.points)
        delays, squares = [0.0], np.empty(0)
        for first in range(DELAYS, len(places) - WINDOW, WINDOW):
            here, there = places[first : first + WINDOW], points[first : first + WINDOW]
            tries = [
                np.linalg.norm(here - points[first - late : first - late + WINDOW], axis=2) for late in range(DELAYS)
            ]
            sums = [float(np.sum(off[np.isfinite(off)] ** 2)) if np.isfinite(off).any() else math.inf for off in tries]
            late = int(np.argmin(sums))
            squares = np.append(squares, tries[late][np.isfinite(tries[late])] ** 2)
            if np.nanmax(np.append(np.linalg.norm(there[-1] - there[0], axis=1), 0.0)) > MOVES_M:
                delays.append(late * LOOK_S)
        return max(delays), float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))

    def _at(self, grid: NDArray[np.float64], looks: list[list[Position]]) -> NDArray[np.float64]:
        """The same at these times."""
        found = np.array(looks).reshape(len(looks), -1)
        columns = [np.interp(grid, self.times, column) for column in found.T]
        return np.array(columns).T.reshape(len(grid), -1, 3)


async def fly_one(drones: str, shape: str, n: int, seed: int) -> dict[str, Any]:
    """One flight; its figures."""
    if drones == "crazyflie":
        config, homes = flight_config(shape, n, seed)
        stand_ins: StandIns | AutopilotStandIns = StandIns(homes, seed=seed)
    else:
        homes = [(x, y, 0.0) for x, y in STARTS[:n]]
        stand_ins = AutopilotStandIns(homes, flavour=drones, lifelike=True)
        config = example(stand_ins.uris, shape=shape)
    with stand_ins:
        if drones == "crazyflie":
            config = addressed(config, homes, stand_ins.uris)
        bodies = Bodies()
        looking = asyncio.create_task(bodies.look([stand_ins[k] for k in range(n)], homes))
        result = await Flight(config, build_fleet(config)).run(yes)
        looking.cancel()
    if result.result is None or result.result.summary.flight is None:
        failed = "; ".join(str(check) for check in result.report.checks if not check.passed)
        return {"formed": False, "landed": False, "why": f"preflight: {failed}"}
    summary, figures = result.result.summary, result.result.summary.flight
    delay_s, rms_m, worst_m = bodies.tracking()
    return {
        "formed": summary.formed,
        "landed": set(figures.ends.values()) == {"landed"},
        "why": figures.ended if figures.reason is None else f"{figures.ended}: {figures.reason}",
        "nearest_m": bodies.nearest_m,
        "delay_s": delay_s,
        "rms_m": rms_m,
        "worst_m": worst_m,
        "lag_s": figures.lag_s,
        "fan_out_ms": figures.fan_out_ms,
        "air_s": figures.air_s,
    }


async def fly_all(drones: str, shape: str, n: int, runs: int, together: int) -> list[dict[str, Any]]:
    """The same flight again and again, some at once."""
    free = asyncio.Semaphore(together)

    async def one(seed: int) -> dict[str, Any]:
        async with free:
            row = await fly_one(drones, shape, n, seed)
        print(json.dumps({"drones": drones, "flight": f"{shape} {n}", **row}), file=sys.stderr, flush=True)
        return row

    return list(await asyncio.gather(*map(one, range(runs))))


def row_of(drones: str, shape: str, n: int, halved: bool, flights: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The row of a table."""
    flown = [flight for flight in flights if "rms_m" in flight]
    good = [flight for flight in flown if flight["formed"] and flight["landed"]]

    early = [flight["why"] for flight in flights if not (flight["formed"] and flight["landed"])]

    def most(name: str, digits: int, pick: Callable[..., float] = max) -> object:
        values = [flight[name] for flight in flown if flight[name] is not None and flight[name] < math.inf]
        return round(pick(values), digits) if values else ""

    return {
        "Drones": DRONES[drones],
        "Flight": f"{shape} {n}",
        "Monitors": "halved" if halved else "as shipped",
        "Runs": len(flights),
        "Formed and landed": len(good),
        "Ended early": " / ".join(f"{count} {why}" for why, count in Counter(early).items()),
        "Smallest distance [m]": most("nearest_m", 3, min),
        "Behind [s]": most("delay_s", 2),
        "Behind, as reported [s]": most("lag_s", 2),
        "Off then, rms [m]": most("rms_m", 3),
        "Off then, at most [m]": most("worst_m", 3),
        "Longest order to all [ms]": most("fan_out_ms", 0),
        "In the air [s]": most("air_s", 0),
    }


def write(rows: Sequence[dict[str, Any]]) -> None:
    """Replace rows of the table."""

    def key(row: Mapping[str, Any]) -> tuple[Any, ...]:
        return row["Drones"], row["Flight"], row["Monitors"]

    with TABLE.open(newline="", encoding="utf-8") as file:
        old = [row for row in csv.DictReader(file) if key(row) not in set(map(key, rows))]
    order = list(itertools.product(DRONES.values(), [f"{shape} {n}" for shape, n, _ in FLIGHTS]))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted([*old, *rows], key=lambda row: (order.index(key(row)[:2]), row["Monitors"])))


def flights() -> None:
    """Formed and landed, every time."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """Read the options, fly, and print a line of JSON of each kind of flight."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks autopilots")
    parser.add_argument("--runs", type=int, default=1, help="how often each is flown")
    parser.add_argument("--drones", choices=DRONES, default="ardupilot", help="kind of the stand-ins")
    parser.add_argument("--only", default="", help="only this shape")
    parser.add_argument("--halved", action="store_true", help="only with halved limits, where that is flown")
    parser.add_argument("--together", type=int, default=1, help="flights at once")
    parser.add_argument("--write", action="store_true", help="write the rows to docs/data/autopilot-flights.csv")
    given = parser.parse_args(arguments)
    plain = monitors.Monitors.__init__

    def strict(self: monitors.Monitors, config: FlightConfig, names: Sequence[str]) -> None:
        plain(self, config, names)
        safety = config.safety
        halves = {"tracking_m": safety.tracking_m / 2, "off_course_s": safety.off_course_s / 2}
        self._safety = safety.model_copy(update=halves)

    for shape, n, halved in FLIGHTS:
        if given.only not in ("", shape) or (given.halved and not halved):
            continue
        monitors.Monitors.__init__ = strict if halved else plain
        done = asyncio.run(fly_all(given.drones, shape, n, given.runs, given.together))
        row = row_of(given.drones, shape, n, halved, done)
        print(json.dumps(row), flush=True)
        if given.write:
            write([row])
    monitors.Monitors.__init__ = plain
