"""Three stand-ins by cflib and by MAVLink: they return, or one dies in any phase; what becomes of all."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

pytest.importorskip("cflib")
pytest.importorskip("pymavlink")

from flights import flight_config
from mavlink_flights import CALM

from llm_flock.planner import NoAnswer, PlanQuestion
from llm_flock.protocol._geometry import GeometryPlanner
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import NEVER_UP, Flight, FlightResult
from llm_flock_flight._flight.landing import LANDED, LOST, STOPPED, TOLD
from llm_flock_flight._flight.preflight import PreflightReport
from llm_flock_flight._testing.crtp import StandIns
from llm_flock_flight._testing.mavlink import AutopilotStandIns

pytestmark = pytest.mark.clock(1.5)

STARTS = ((-0.8, -0.6), (0.8, -0.6), (0.0, 0.9))
VICTIM = 1

STOCK: dict[str, Any] = {
    "robot": "crazyflie",
    "take_off_s": 2.5,
    "round_s": 2.5,
    "land_s": 2.5,
    "max_speed_m_s": 1.0,
    "stall_s": 1.2,
}
QUICK: dict[str, Any] = {"reach_s": 3.0, "connect_s": 4.0, "settle_s": 1.0, "model": "geometry", "think_s": 600.0}

Kill = Callable[[], None]


class Team:
    """Three stand-ins, of which one can be killed: it falls, and is never heard again."""

    def __init__(self, driver: str, made: Any) -> None:
        self._driver, self._made = driver, made

    def kill(self) -> None:
        victim = self._made[VICTIM]
        if self._driver == "crazyflie":
            victim.die()
        else:
            victim.silent = True
            with victim.lock:
                victim.autopilot.body.motors = False

    def from_starts(self) -> list[float]:
        """How far each is from its start [m]."""
        return [math.dist(self._made[k].position, (*start, 0.0)) for k, start in enumerate(STARTS)]

    def turning(self) -> list[bool]:
        """Whose motors turn."""
        made = self._made
        return [made[k].flying if self._driver == "crazyflie" else made[k].armed for k in range(len(made))]


@contextmanager
def team_of(driver: str) -> Generator[tuple[Team, FlightConfig]]:
    homes = [(x, y, 0.0) for x, y in STARTS]
    made = StandIns(homes) if driver == "crazyflie" else AutopilotStandIns(homes, flavour=driver)
    with made as stand_ins:
        fields = STOCK if driver == "crazyflie" else CALM
        ids = [{} if driver == "crazyflie" else {"system_id": k + 1} for k in range(3)]
        drones = [
            {"name": f"d{k}", "uri": stand_ins.uris[k], "start": start, **ids[k]} for k, start in enumerate(STARTS)
        ]
        yield (
            Team(driver, stand_ins),
            flight_config(3, "triangle", {"spacing": 8}, drones=drones, **{**fields, **QUICK}),
        )


async def flown(config: FlightConfig, phase: str, kill: Kill) -> FlightResult:
    """One flight, with a death in the middle of a phase."""
    safety, tasks = config.safety, list[asyncio.Task[None]]()
    when = {
        "taking off": ("taking off", safety.take_off_s / 2),
        "motion": ("flying", safety.round_s / 2),
        "hold": ("flying", 1.0),
        "landing": ("landing", safety.land_s / 2),
    }

    async def later(seconds: float, act: Callable[[], object]) -> None:
        await asyncio.sleep(seconds)
        act()

    def on_stage(stage: str) -> None:
        loop = asyncio.get_running_loop()
        if stage == "connecting" and phase == "connecting":
            kill()
        at, seconds = when.get(phase, ("", 0.0))
        if stage == at:
            tasks.append(loop.create_task(later(seconds, kill)))
        if stage == "flying" and phase == "landing":
            tasks.append(loop.create_task(later(0.5, flight.abort)))

    async def confirm(report: PreflightReport) -> bool:
        if phase == "preflight":
            kill()
            await asyncio.sleep(2 * safety.stall_s)
        return True

    flight = Flight(config, build_fleet(config), on_stage=on_stage)
    return await flight.run(confirm)


async def _for_ever(planner: GeometryPlanner, question: PlanQuestion) -> NoAnswer:
    await asyncio.sleep(3600.0)
    return NoAnswer(cause="timeout", reason="")


GONE = (LOST, TOLD)

PHASES: dict[str, tuple[set[str], Sequence[str], Sequence[str]]] = {
    "preflight": ({"link_lost", "refused"}, (NEVER_UP, *GONE), (NEVER_UP, LANDED, STOPPED)),
    "taking off": ({"link_lost", "refused"}, GONE, (LANDED, STOPPED)),
    "motion": ({"link_lost", "off_course"}, GONE, (LANDED,)),
    "hold": ({"link_lost"}, GONE, (LANDED,)),
    "landing": ({"abort"}, GONE, (LANDED,)),
}
"""By phase: how the flight may end, the drone that died, and the others; just off the ground these may stop unseen.

With the long `stall_s` of these tests, a drone that does not arrive is noticed before its silence."""


@pytest.mark.parametrize("driver", ["crazyflie", "px4"])
def test_drone_dead_before_connecting_keeps_all_on_the_ground(driver: str) -> None:
    with team_of(driver) as (team, config):
        done = asyncio.run(flown(config, "connecting", team.kill))
        assert done.result is None
        failed = [(check.who, check.name) for check in done.report.checks if not check.passed]
        assert failed == [("d1", "connected")] and not any(team.turning())


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("driver", ["crazyflie", "px4"])
def test_one_that_dies_is_named_and_the_others_land(driver: str, phase: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ended, victim, others = PHASES[phase]
    if phase == "hold":  # they hover while no drone has a plan
        monkeypatch.setattr(GeometryPlanner, "plan", _for_ever)
    with team_of(driver) as (team, config):
        done = asyncio.run(flown(config, phase, team.kill))
        assert done.result is not None and done.result.summary.flight is not None
        flight = done.result.summary.flight
        assert driver == "px4" or flight.ended != "off_course"
        assert flight.ended in ended and (phase == "landing" or "d1" in str(flight.reason)), flight.reason
        assert flight.ends["d1"] in victim and {flight.ends["d0"], flight.ends["d2"]} <= {*others}
        assert flight.safe is (flight.ends["d1"] == NEVER_UP)
        assert (flight.min_separation_m or 1.0) >= config.safety.min_separation_m
        turning = team.turning()
        assert not turning[0] and not turning[2]


@pytest.mark.parametrize("driver", ["crazyflie", "px4", "ardupilot"])
def test_the_operator_lets_all_return(driver: str) -> None:
    with team_of(driver) as (team, config):
        places: list[list[float]] = []

        def on_stage(stage: str) -> None:
            if stage == "flying":
                asyncio.get_running_loop().call_later(1.4 * config.safety.round_s, flight.return_home)
            if stage == "returning":
                places.append(team.from_starts())

        async def yes(_: PreflightReport) -> bool:
            return True

        flight = Flight(config, build_fleet(config), on_stage=on_stage)
        done = asyncio.run(flight.run(yes))
        assert done.result is not None and done.result.summary.flight is not None
        figures = done.result.summary.flight
        assert figures.ended == "return" and figures.reason is None, figures.reason
        assert figures.safe and set(figures.ends.values()) == {LANDED} and not any(team.turning())
        assert (figures.min_separation_m or 0.0) >= config.safety.min_separation_m
        ((away, *_),) = [sorted(found, reverse=True) for found in places]
        assert away > 1.1  # a metre high, and half a metre aside
        assert max(team.from_starts()) <= config.safety.tracking_m + 0.05
