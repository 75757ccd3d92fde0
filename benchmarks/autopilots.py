"""The shipped example for MAVLink, flown by stand-ins that lift and climb as late as ArduCopter 4.7.

    python -m benchmarks autopilots --csv docs/data/autopilot-flights.csv     every flight once, and each limit halved
    python -m benchmarks autopilots --runs 5 --flavour px4                    five of each by stand-ins for PX4

The example's own safety numbers, its starts and one more; only the drones take off together. Distances are those of
the stand-ins' own positions. `halved` has half of `tracking_m` and of `off_course_s` in the monitors.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import itertools
import json
import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from benchmarks.flight import yes

from llm_flock_flight._flight import monitors
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._testing.mavlink import AutopilotStandIns

EXAMPLE = Path(__file__).parents[1] / "examples" / "flight_mavlink.toml"
STARTS = ((0.0, 0.0), (6.0, 0.0), (0.0, 6.0), (6.0, 6.0), (3.0, 3.0))
FLIGHTS = (("triangle", 3, False), ("cross", 5, False), ("circle", 5, False), ("square", 4, False), ("square", 4, True))


async def fly_one(flavour: str, shape: str, n: int, halved: bool) -> dict[str, Any]:
    """One flight; its figures."""
    with AutopilotStandIns([(x, y, 0.0) for x, y in STARTS[:n]], flavour=flavour, lifelike=True) as stand_ins:
        drones = [
            {"name": f"v{k}", "uri": uri, "system_id": k + 1, "start": STARTS[k]}
            for k, uri in enumerate(stand_ins.uris)
        ]
        base = FlightConfig.load(EXAMPLE).model_dump(exclude_unset=True)
        config = FlightConfig.build(base, shape=shape, n_robots=n, drones=drones, take_off_group=n)
        nearest = [math.inf]

        async def watch() -> None:
            while True:
                places = [stand_ins[k].position for k in range(n)]
                nearest.append(min(nearest.pop(), *itertools.starmap(math.dist, itertools.combinations(places, 2))))
                await asyncio.sleep(0.02)

        looking = asyncio.create_task(watch())
        plain = monitors.Monitors.__init__

        def strict(self: monitors.Monitors, config: FlightConfig, names: Sequence[str]) -> None:
            plain(self, config, names)
            safety = config.safety
            self._safety = safety.model_copy(
                update={"tracking_m": safety.tracking_m / 2, "off_course_s": safety.off_course_s / 2}
            )

        if halved:
            monitors.Monitors.__init__ = strict
        try:
            result = await Flight(config, build_fleet(config)).run(yes)
        finally:
            monitors.Monitors.__init__ = plain
        looking.cancel()
    assert result.result is not None and result.result.summary.flight is not None, result.report
    summary, figures = result.result.summary, result.result.summary.flight
    return {
        "Autopilot": flavour,
        "Flight": f"{shape} {n}",
        "Monitors": "halved" if halved else "as shipped",
        "Formed": summary.formed,
        "Landed": set(figures.ends.values()) == {"landed"},
        "Ended": figures.ended,
        "Smallest distance [m]": round(nearest[0], 3),
        "Tracking, rms [m]": round(figures.tracking_rms_m or 0.0, 3),
        "Tracking, at most [m]": round(figures.tracking_max_m or 0.0, 3),
        "In the air [s]": round(figures.air_s, 1),
    }


def flights() -> None:
    """Formed and landed, every time."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """Read the options, fly, and print a line of CSV of each flight."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks autopilots")
    parser.add_argument("--runs", type=int, default=1, help="how often each is flown")
    parser.add_argument("--flavour", choices=("ardupilot", "px4"), default="ardupilot", help="kind of the stand-ins")
    parser.add_argument("--only", default="", help="only this shape")
    parser.add_argument("--csv", type=Path, help="file to write")
    given = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    for shape, n, halved in FLIGHTS:
        for _ in range(given.runs if given.only in ("", shape) else 0):
            rows.append(asyncio.run(fly_one(given.flavour, shape, n, halved)))
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    with given.csv.open("w", newline="", encoding="utf-8") if given.csv else nullcontext(sys.stdout) as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
