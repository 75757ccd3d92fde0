"""Flights of stand-ins through the real cflib: the paper's four, and every failure that a flight must survive.

    python -m benchmarks flight         the four flights, 20 of each with random starts (eight minutes)
    python -m benchmarks flight-cases   each safety case once: the reaction, its stated and its measured time

Flights take as long as they take. Those of the paper are flown five at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from llm_flock.robots.base import Position
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.fleet import build_fleet, start_of, with_drones
from llm_flock.runtime.flight.flight import Flight, FlightResult
from llm_flock.runtime.flight.reaction_times import reaction_times
from llm_flock.runtime.flight.timed_planner import TimedPlanner
from llm_flock.testing.crtp import StandIn, StandIns

FLIGHTS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5))
"""What the paper flies."""

RUNS = 20
TOGETHER = 5
"""Flights at once: each is idle most of the time."""

ROOM: dict[str, Any] = {"center": [20, 20], "arena": [[0, 0], [40, 40]], "comm_range": 20}
FAST: dict[str, Any] = {
    "robot": "crazyflie",
    "take_off_group": 2,
    "round_s": 2.0,
    "max_speed_m_s": 1.4,
    "take_off_s": 1.6,
    "land_s": 1.6,
    "connect_s": 5.0,
}
"""A room of 4 x 4 m at a tenth of a metre per unit; faster than real drones would fly indoors."""


def flight_config(shape: str, n: int, seed: int, **fields: Any) -> tuple[FlightConfig, list[Position]]:
    """A flight from random starts, its drones without addresses yet; and those starts [m]."""
    mission = {"shape": shape, "n_robots": n, **ROOM}
    config = FlightConfig.build({"mission": mission}, **{**FAST, "seed": seed, **fields})
    return config, homes_of(config)


def addressed(config: FlightConfig, homes: Sequence[Position], uris: Sequence[str]) -> FlightConfig:
    """The same flight with the addresses of stand-ins."""
    fleet = [
        {"name": f"cf{k}", "uri": uri, "start": home[:2]} for k, (home, uri) in enumerate(zip(homes, uris, strict=True))
    ]
    base = config.model_dump(exclude_unset=True)
    return FlightConfig.build(base, drones=fleet)


def case_config(shape: str, n: int, seed: int, **fields: Any) -> tuple[FlightConfig, list[Position]]:
    """The flight in which something happens."""
    return flight_config(shape, n, seed, take_off_group=4, reach_s=8.0, think_s=2.0, **fields)


def homes_of(config: FlightConfig) -> list[Position]:
    """Positions of its drones before take-off [m]."""
    return [start_of(config, drone) for drone in with_drones(config).fleet.drones]


async def yes(_: object) -> bool:
    return True


DEADMAN_S = 3.0
"""Time for the deadman to hear that the stand-ins are down [s]."""


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


async def fly_one(shape: str, n: int, seed: int, **fields: Any) -> dict[str, Any]:
    """One flight; its figures."""
    config, homes = flight_config(shape, n, seed, **fields)
    with StandIns(homes) as stand_ins:
        config = addressed(config, homes, stand_ins.uris)
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        result = await Flight(config, build_fleet(config)).run(yes)
        looking.cancel()
        assert result.result is not None, [str(check) for check in result.report.checks if not check.passed]
        summary = result.result.summary
        assert summary.flight is not None
        return {
            "shape": shape,
            "n": n,
            "seed": seed,
            "formed": summary.formed,
            "landed": set(summary.flight.ends.values()) == {"landed"},
            "ended": summary.flight.ended,
            "rounds": summary.rounds,
            "nearest_m": watch.nearest_m,
            "least_m": config.safety.min_separation_m,
            "tracking_max_m": summary.flight.tracking_max_m,
            "fan_out_ms": summary.flight.fan_out_ms,
            "connect_s": result.report.connect_s,
        }


def show(rows: Sequence[dict[str, Any]]) -> None:
    """The table of the paper's flights (Markdown)."""
    print(
        "| Flight | Runs | Formed | Landed | Smallest distance [m] | Off set-points [cm] | Longest go_to to all [ms] |"
    )
    print("|---|---|---|---|---|---|---|")
    for shape, n in FLIGHTS:
        mine = [row for row in rows if (row["shape"], row["n"]) == (shape, n)]
        if not mine:
            continue
        formed, landed = sum(row["formed"] for row in mine), sum(row["landed"] for row in mine)
        print(
            f"| {shape} {n} | {len(mine)} | {formed} | {landed} | {min(row['nearest_m'] for row in mine):.3f} "
            f"| {100 * max(row['tracking_max_m'] for row in mine):.1f} "
            f"| {statistics.median(row['fan_out_ms'] for row in mine):.1f} "
            f"(at most {max(row['fan_out_ms'] for row in mine):.1f}) |",
            flush=True,
        )


def paper_flights() -> None:
    """Bar 1: formed, landed, no separation violation, every time."""
    flights = [(shape, n, seed) for shape, n in FLIGHTS for seed in range(RUNS)]
    show([row for k in range(0, len(flights), TOGETHER) for row in asyncio.run(fly_all(flights[k : k + TOGETHER]))])


async def fly_all(flights: Sequence[tuple[str, int, int]]) -> list[dict[str, Any]]:
    """Several separate flights at once."""
    return list(await asyncio.gather(*(fly_one(*flight) for flight in flights)))


# ------------------------------------------------------------------------------------------------ what goes wrong


@dataclass
class Scene:
    """A flight in the middle of which something fails."""

    flight: Flight
    stand_ins: StandIns
    config: FlightConfig

    @property
    def victim(self) -> StandIn:
        """The drone that fails."""
        return self.stand_ins[1]


async def _link_returns(scene: Scene) -> float:
    scene.victim.lose_link()
    await asyncio.sleep(3.0)
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


CASES: dict[str, Callable[[Scene], Awaitable[float]]] = {
    "link_returns": _link_returns,
    "link_gone": lambda scene: _at_once(scene.victim.lose_link),
    "estimate_jumps": lambda scene: _at_once(lambda: scene.victim.jump((0.5, 0.4, 0.0))),
    "estimate_stalls": lambda scene: _at_once(scene.victim.stall),
    "estimate_stops": lambda scene: _at_once(scene.victim.mute_log),
    "battery_low": lambda scene: _at_once(lambda: scene.victim.set_battery(3.0)),
    "geofence": lambda scene: _at_once(lambda: _believe_to_be_at(scene, -9.0)),
    "far_outside": lambda scene: _at_once(lambda: _believe_to_be_at(scene, -12.0)),
    "too_near": lambda scene: _at_once(lambda: _next_to_another(scene)),
    "abort": lambda scene: _at_once(scene.flight.abort),
    "emergency": lambda scene: _at_once(scene.flight.emergency),
}
"""Each causes a failure, and returns the moment from which its time counts."""


async def fly_case(name: str, after_s: float = 1.5) -> dict[str, Any]:
    """One flight with one failure; returns its outcome."""
    # Where a drone is where it should not be, because its estimate is wrong, the jump is not to be noticed first.
    jump_m = 100.0 if name in ("geofence", "far_outside", "too_near") else 0.3
    cut_outside_m = 10.0 if name == "geofence" else 1.0
    config, homes = case_config("square", 4, 3, deadman=False, jump_m=jump_m, cut_outside_m=cut_outside_m)
    with StandIns(homes) as stand_ins:
        config = addressed(config, homes, stand_ins.uris)
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        flying = asyncio.Event()

        def on_stage(stage: str) -> None:
            if stage == "flying":
                flying.set()

        flight = Flight(config, build_fleet(config), on_stage=on_stage)
        with _mute() if name == "model_silent" else contextlib.nullcontext():
            task = asyncio.create_task(flight.run(yes))
            await flying.wait()
            began = time.monotonic()
            if name != "model_silent":
                await asyncio.sleep(after_s)
                began = await CASES[name](Scene(flight, stand_ins, config))
            result = await task
        await asyncio.sleep(0.1)
        looking.cancel()
        # A drone that hovers out of reach is as safe as it can be once everybody else is down and it is named.
        until = time.monotonic() - 0.1 if watch.all_off_s is None else watch.all_off_s
        return _row(name, config, result, until - began, watch.nearest_m)


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


def _row(name: str, config: FlightConfig, result: FlightResult, took_s: float, nearest_m: float) -> dict[str, Any]:
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
    } | _stated(name, config)


def _stated(name: str, config: FlightConfig) -> dict[str, Any]:
    reaction = reaction_times(config)[name]
    return {"what": reaction.case, "does": reaction.does, "stated_s": reaction.stated_s}


async def fly_and_lose_the_process(name: str) -> dict[str, Any]:
    """Kill or stop the flight process in the middle of a round; returns what the deadman does."""
    config, homes = case_config("square", 4, 3)
    with StandIns(homes) as stand_ins, tempfile.TemporaryDirectory() as folder:
        config = addressed(config, homes, stand_ins.uris)
        watch = Watch(stand_ins)
        looking = asyncio.create_task(watch.look())
        file = Path(folder) / "flight.json"
        file.write_text(config.model_dump_json(exclude_none=True), encoding="utf-8")
        code = (
            "import asyncio, json, sys; from benchmarks.flight import *;"
            "c = FlightConfig.model_validate_json(open(sys.argv[1]).read());"
            "asyncio.run(Flight(c, build_fleet(c), on_stage=lambda s: print(s, flush=True)).run(yes))"
        )
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", code, str(file), stdout=asyncio.subprocess.PIPE
        )
        assert process.stdout is not None
        async for line in process.stdout:
            if line.strip() == b"flying":
                break
        await asyncio.sleep(1.5)
        watch.all_off.clear()
        began = time.monotonic()
        os.kill(process.pid, signal.SIGKILL if name == "killed" else signal.SIGSTOP)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(watch.all_off.wait(), 30.0)
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        await asyncio.sleep(DEADMAN_S)
        looking.cancel()
        places = [stand_ins[k].position for k in range(len(stand_ins))]
        landed = sum(z < 0.01 for _, _, z in places)
        took_s = (watch.all_off_s or float("inf")) - began
        row = {"case": name, "ended": name, "ends": f"{landed} landed", "took_s": took_s, "nearest_m": watch.nearest_m}
        return row | _stated(name, config)


def show_cases(rows: Sequence[dict[str, Any]]) -> None:
    """The table of the safety cases (Markdown)."""
    print("| Case | What is done | Stated [s] | Measured [s] | In the end | Smallest distance [m] |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['what']} | {row['does']} | {row['stated_s']:.1f} | {row['took_s']:.1f} | {row['ends']} "
            f"| {row['nearest_m']:.2f} |",
            flush=True,
        )


def case(name: str) -> dict[str, Any]:
    """One case."""
    if name in ("killed", "hangs"):
        return asyncio.run(fly_and_lose_the_process(name))
    return asyncio.run(fly_case(name))


def safety_cases() -> None:
    """Bar 2: every case ends in a safe state in its stated time."""
    show_cases([case(name) for name in (*CASES, "model_silent", "killed", "hangs")])


def main(arguments: Sequence[str]) -> None:
    """For parts of it: cases by name, one after the other, or SHAPE/N/SEED, five at once; a line of JSON each."""
    flights = [(shape, int(n), int(seed)) for shape, n, seed in (text.split("/") for text in arguments if "/" in text)]
    for k in range(0, len(flights), TOGETHER):
        for row in asyncio.run(fly_all(flights[k : k + TOGETHER])):
            print(json.dumps(row), flush=True)
    for text in arguments:
        if "/" not in text:
            print(json.dumps(case(text)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
