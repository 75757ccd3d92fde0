"""Twenty stand-ins on modelled Crazyradios, through the real cflib: `python -m benchmarks radio`.

The radios are a model (`llm_flock_flight._testing.crtp.radio`), not radios: it says what sharing costs if an exchange
takes as long as it is said to take, and nothing about range or interference.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

from llm_flock.robots._base import RobotError
from llm_flock_flight._cli.stand_ins import grid
from llm_flock_flight._crazyflie import CrazyflieRobot
from llm_flock_flight._crazyflie.radios import EXCHANGE_S, SETTING_S, exchanges_of, plan_radios, proposed_uris
from llm_flock_flight._testing.crtp import ModelledRadio, StandIns

DRONES = 20
RADIOS = (1, 2, 4)
LOSS = 0.02
SECONDS = 10.0
GO_TO_S = 0.8
"""Duration of each way-point; the next one is sent as soon as all have confirmed it [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What was measured on some modelled radios.

    Attributes:
        connected_s: until all drones were connected, or could not be [s].
        n_connected: how many were.
        commands_hz: confirmed commands a second, of all drones together.
        failed: commands that were not confirmed in eight tries.
        fan_out_s: time for a command to all, from the first sent to the last confirmed; one for each round [s].
        oldest_s: age of the oldest position of all drones, looked at 20 times a second [s].
        dropped: packets for which a queue had no room.
    """

    connected_s: float
    n_connected: int
    commands_hz: float
    failed: int
    fan_out_s: tuple[float, ...]
    oldest_s: tuple[float, ...]
    dropped: int


async def measure(n_radios: int) -> Figures | str:
    """Connect, take off, and send way-points to all drones at once, as a flight does; why not, if none connects."""
    homes = grid(DRONES, 0.6)
    radios = [ModelledRadio(EXCHANGE_S + SETTING_S, loss=LOSS, seed=k) for k in range(n_radios)]
    with StandIns(homes, radios=radios) as drones:
        team = [CrazyflieRobot(f"cf{k}", uri) for k, uri in enumerate(drones.uris)]
        began = time.monotonic()
        made = await asyncio.gather(*(robot.connect(60.0) for robot in team), return_exceptions=True)
        connected_s = time.monotonic() - began
        up = [k for k, result in enumerate(made) if result is None]
        if not up:
            return f"none connected in {connected_s:.0f} s; the first: {made[0]}"
        await asyncio.gather(*(team[k].arm() for k in up), return_exceptions=True)
        await asyncio.gather(*(team[k].take_off(0.5, 1.0) for k in up), return_exceptions=True)
        await asyncio.sleep(1.5)
        oldest: list[float] = []
        looking = asyncio.create_task(_look(team, up, radios, oldest))
        confirmed, failed, fan_out, began = 0, 0, list[float](), time.monotonic()
        while time.monotonic() - began < SECONDS:
            y, sent = (0.05 if len(fan_out) % 2 else 0.0), time.monotonic()
            orders = (team[k].go_to((homes[k][0], homes[k][1] + y, 0.5), GO_TO_S) for k in up)
            results = await asyncio.gather(*orders, return_exceptions=True)
            fan_out.append(time.monotonic() - sent)
            failed += sum(isinstance(result, BaseException) for result in results)
            confirmed += sum(not isinstance(result, BaseException) for result in results)
        seconds = time.monotonic() - began
        looking.cancel()
        for robot in team:
            with contextlib.suppress(RobotError, TimeoutError):
                await robot.close()
    return Figures(
        connected_s=connected_s,
        n_connected=len(up),
        commands_hz=confirmed / seconds,
        failed=failed,
        fan_out_s=tuple(fan_out),
        oldest_s=tuple(oldest),
        dropped=sum(radio.dropped for radio in radios),
    )


async def _look(
    team: Sequence[CrazyflieRobot], up: Sequence[int], radios: Sequence[ModelledRadio], oldest: list[float]
) -> None:
    """Note the age of the oldest position: since it came, and the time that its packet had waited."""
    while True:
        now = time.monotonic()
        waited = {k: seconds for radio in radios for k, seconds in list(radio.last_wait_s.items())}
        oldest.append(max(now - team[k].state().stamp_s + waited.get(k, 0.0) for k in up))
        await asyncio.sleep(0.05)


def radio() -> None:
    """One, two and four radios."""
    logging.disable(logging.WARNING)
    each_s = EXCHANGE_S + SETTING_S
    print(f"{DRONES} stand-ins on modelled Crazyradios; a model, not radios: an exchange takes {1000 * each_s:.1f} ms,")
    print(f"{LOSS:.0%} of all exchanges are lost; way-points to all drones, one after another, for {SECONDS:g} s")
    for n_radios in RADIOS:
        uris = [(f"cf{k}", uri) for k, uri in enumerate(proposed_uris(DRONES, n_radios))]
        share = max(load.share for load in plan_radios(uris, exchanges_of(round_s=3.0)).loads)
        found = asyncio.run(measure(n_radios))
        if isinstance(found, str):
            print(f"{n_radios} radios: planned share {share:.0%}; {found}", flush=True)
            continue
        fan_out, oldest = (sorted(1000 * value for value in row) for row in (found.fan_out_s, found.oldest_s))
        print(
            f"{n_radios} radios: planned share {share:.0%}; {found.n_connected} connected in {found.connected_s:.1f} s;"
            f" {found.commands_hz:.0f} commands/s confirmed, {found.failed} not; a command to all: median "
            f"{statistics.median(fan_out):.0f} ms, longest {fan_out[-1]:.0f} ms; oldest position: median "
            f"{statistics.median(oldest):.0f} ms, longest {oldest[-1]:.0f} ms; {found.dropped} packets dropped",
            flush=True,
        )
