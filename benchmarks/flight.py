"""Flights of stand-ins through the real cflib: the paper's four, with the default flight file.

    python -m benchmarks flight                          twenty random starts of each, with the stock PID controller
    python -m benchmarks flight --runs 5                 five of each
    python -m benchmarks flight --controller mellinger   with another controller, set by the flight file
    python -m benchmarks flight --loss 0.1               a tenth of all packets is lost, in each direction
    python -m benchmarks flight --only circle/5/3        some flights, SHAPE/N/SEED
    python -m benchmarks flight --simulated              drones of this process, without cflib and without waiting

On a machine so busy that this process stands still for half a second, flights end early, as they should. With
`--simulated` they take about a second of work each, whatever else the machine does.

Flights take as long as they take, and are flown five at once (`--together`); standard error gets a line of JSON of
each. What may go wrong in one is in benchmarks/flight_cases.py.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from llm_flock.robots._base import Position
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet, start_of, with_drones
from llm_flock_flight._flight.flight import Flight, FlightResult
from llm_flock_flight._testing.crtp import StandIns

FLIGHTS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5))
"""What the paper flies."""

RUNS = 20
TOGETHER = 5
"""Flights at once: each is idle most of the time."""

ROOM: dict[str, Any] = {"center": [20, 20], "arena": [[0, 0], [40, 40]], "comm_range": 20}
"""A room of 4 x 4 m at a tenth of a metre per unit."""

TABLES = Path(tempfile.gettempdir()) / "llm-flock-benchmark-tables"
"""Where the drones' tables are kept."""


def flight_config(shape: str, n: int, seed: int, **fields: Any) -> tuple[FlightConfig, list[Position]]:
    """A flight from random starts, its drones without addresses yet; and those starts [m]."""
    mission = {"shape": shape, "n_robots": n, **ROOM}
    # A deadman of one flight would end the process, and with it all other flights: `flight_cases` tests it.
    given = {"robot": "crazyflie", "cache": str(TABLES), "deadman": False, "seed": seed, **fields}
    config = FlightConfig.build({"mission": mission}, **given)
    return config, homes_of(config)


def addressed(config: FlightConfig, homes: Sequence[Position], uris: Sequence[str]) -> FlightConfig:
    """The same flight with the addresses of stand-ins."""
    fleet = [
        {"name": f"cf{k}", "uri": uri, "start": home[:2]} for k, (home, uri) in enumerate(zip(homes, uris, strict=True))
    ]
    base = config.model_dump(exclude_unset=True)
    return FlightConfig.build(base, drones=fleet)


def homes_of(config: FlightConfig) -> list[Position]:
    """Positions of its drones before take-off [m]."""
    return [start_of(config, drone) for drone in with_drones(config).fleet.drones]


async def yes(_: object) -> bool:
    return True


class Watch:
    """Follows the true positions of stand-ins: their smallest distance in the air, and when all motors went off."""

    def __init__(self, stand_ins: StandIns) -> None:
        self._drones = [stand_ins[k] for k in range(len(stand_ins))]
        self.nearest_m = float("inf")
        self.all_off_s: float | None = None
        self.all_off = asyncio.Event()

    async def look(self) -> None:
        """Until cancelled."""
        while True:
            now = time.monotonic()
            flying = [drone for drone in self._drones if drone.flying]
            places = [drone.position for drone in flying]
            for k, a in enumerate(places):
                for b in places[:k]:
                    self.nearest_m = min(self.nearest_m, ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) ** 0.5)
            if flying:
                self.all_off_s = None
                self.all_off.clear()
            elif self.all_off_s is None:
                self.all_off_s = now
                self.all_off.set()
            await asyncio.sleep(0.02)


async def fly_one(shape: str, n: int, seed: int, loss: float = 0.0, **fields: Any) -> dict[str, Any]:
    """One flight; its figures."""
    config, homes = flight_config(shape, n, seed, **fields)
    with StandIns(homes, loss=loss, seed=seed) as stand_ins:
        config = addressed(config, homes, stand_ins.uris)
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        result = await Flight(config, build_fleet(config)).run(yes)
        looking.cancel()
        return _row(shape, n, seed, config, result, watch.nearest_m)


def _row(
    shape: str, n: int, seed: int, config: FlightConfig, result: FlightResult, nearest_m: float | None
) -> dict[str, Any]:
    """The figures of a flight; the smallest distance is that of estimates where true positions were not watched."""
    row: dict[str, Any] = {"shape": shape, "n": n, "seed": seed, "formed": False, "landed": False}
    if result.result is None:
        return row | {"ended": "; ".join(str(check) for check in result.report.checks if not check.passed)}
    summary = result.result.summary
    assert summary.flight is not None
    return row | {
        "formed": summary.formed,
        "landed": set(summary.flight.ends.values()) == {"landed"},
        "ended": summary.flight.ended,
        "reason": summary.flight.reason,
        "ends": summary.flight.ends,
        "rounds": summary.rounds,
        "air_s": summary.flight.air_s,
        "nearest_m": summary.flight.min_separation_m if nearest_m is None else nearest_m,
        "least_m": config.safety.min_separation_m,
        "tracking_max_m": summary.flight.tracking_max_m,
        "lag_s": summary.flight.lag_s,
        "fan_out_ms": summary.flight.fan_out_ms,
        "connect_s": result.report.connect_s,
    }


def show(rows: Sequence[dict[str, Any]]) -> None:
    """The table of the paper's flights (Markdown)."""
    print(
        "| Flight | Runs | Formed | Landed | Smallest distance [m] | Behind [s] | Off the set-point then [cm] "
        "| Longest go_to to all [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for shape, n in FLIGHTS:
        mine = [row for row in rows if (row["shape"], row["n"]) == (shape, n)]
        flown = [row for row in mine if "nearest_m" in row]
        if not flown:
            continue
        formed, landed = sum(row["formed"] for row in mine), sum(row["landed"] for row in mine)
        fan_outs = [row["fan_out_ms"] for row in flown if row["fan_out_ms"] is not None]
        print(
            f"| {shape} {n} | {len(mine)} | {formed} | {landed} | {min(row['nearest_m'] for row in flown):.3f} "
            f"| {max(row['lag_s'] for row in flown):.2f} | {100 * max(row['tracking_max_m'] for row in flown):.1f} "
            f"| {statistics.median(fan_outs):.1f} (at most {max(fan_outs):.1f}) |",
            flush=True,
        )
    for row in rows:
        if not (row["formed"] and row["landed"]):
            print(json.dumps(row), flush=True)


async def fly_all(flights: Sequence[tuple[str, int, int]], together: int, **options: Any) -> list[dict[str, Any]]:
    """Several separate flights, some at once; a new one begins as soon as one has ended."""
    free = asyncio.Semaphore(together)

    async def one(flight: tuple[str, int, int]) -> dict[str, Any]:
        async with free:
            row = await fly_one(*flight, **options)
        print(json.dumps(row), file=sys.stderr, flush=True)
        return row

    return list(await asyncio.gather(*map(one, flights)))


def fly_simulated(flights: Sequence[tuple[str, int, int]], controller: str | None) -> list[dict[str, Any]]:
    """The same flights by drones of this process that lag as the stock controller does, or not at all."""
    import pytest
    from skipped_waits import skip_waits

    robot = "flights:stock" if controller in (None, "pid") else "simulated"
    rows: list[dict[str, Any]] = []
    with pytest.MonkeyPatch.context() as patch:
        skip_waits(patch)
        for shape, n, seed in flights:
            config, _ = flight_config(shape, n, seed, robot=robot)
            config = with_drones(config)
            result = asyncio.run(Flight(config, build_fleet(config)).run(yes))
            rows.append(_row(shape, n, seed, config, result, None))
    return rows


def paper_flights() -> None:
    """Formed, landed, no separation violation, every time."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """Read the options, fly, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks flight")
    parser.add_argument("--runs", type=int, default=RUNS, help="random starts of each flight")
    parser.add_argument(
        "--controller",
        choices=("pid", "mellinger", "indi", "brescianini", "lee"),
        help="controller that the flight file sets; else the stock one, PID",
    )
    parser.add_argument("--loss", type=float, default=0.0, help="share of packets lost, in each direction")
    parser.add_argument("--together", type=int, default=TOGETHER, help="flights at once")
    parser.add_argument("--simulated", action="store_true", help="drones of this process, without waiting")
    parser.add_argument("--only", nargs="*", default=[], metavar="SHAPE/N/SEED", help="only these flights")
    given = parser.parse_args(arguments)
    options: dict[str, Any] = {"loss": given.loss}
    if given.controller is not None:
        options["controller"] = given.controller
    flights = [(shape, n, seed) for seed in range(given.runs) for shape, n in FLIGHTS]
    if given.only:
        flights = [(shape, int(n), int(seed)) for shape, n, seed in (text.split("/") for text in given.only)]
    if given.simulated:
        show(fly_simulated(flights, given.controller))
    else:
        show(asyncio.run(fly_all(flights, given.together, **options)))
