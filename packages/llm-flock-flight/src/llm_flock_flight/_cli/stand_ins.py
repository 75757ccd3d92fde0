"""`llm-flock stand-ins`: try a flight without drones."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from llm_flock.cli import say
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.robots import Position
    from llm_flock_flight._testing import crtp, mavlink

    Drones: TypeAlias = crtp.StandIns | mavlink.AutopilotStandIns

LAST_PORT = 65_535  # highest UDP port
MAX_VEHICLES = 254  # most stand-in autopilots: MAVLink's system ids are 1 to 254, and 255 is ours


def stand_ins(
    count: Annotated[int, typer.Argument(min=1, help="Number of drones; with --crazyflies, those of the file")] = 1,
    port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the first; the others follow")] = 19850,
    spacing: Annotated[float, typer.Option(min=0.01, help="Spacing of the drones' square grid [m]")] = 1.0,
    crazyflies: Annotated[
        Path | None, typer.Option(help="Stand in for each enabled udp:// robot of this crazyflies.yaml")
    ] = None,
    mavlink: Annotated[
        Literal["px4", "ardupilot"] | None,
        typer.Option(help="Stand in for autopilots of this kind instead: each calls its own UDP port of this machine"),
    ] = None,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of packets lost, in each direction")] = 0.0,
    radios: Annotated[
        int, typer.Option(min=0, max=16, help="Model this many Crazyradios that carry the packets [default: none]")
    ] = 0,
    outside: Annotated[bool, typer.Option("--outside", help="Drones that fly by positions from outside")] = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time [default: run until Ctrl-C] [s]")
    ] = None,
) -> None:
    """Stand in for drones: point masses that speak their protocol over UDP, for flights without hardware."""
    host = "127.0.0.1"
    if crazyflies is None:
        if count > LAST_PORT:
            raise InputError("count", count, f"at most {LAST_PORT}: each has a port")
        homes = grid(count, spacing)
    else:
        host, port, homes = _from_file(crazyflies)
    if not math.isfinite(spacing):
        raise InputError("spacing", spacing, "a finite number")
    if port + len(homes) - 1 > LAST_PORT:
        raise InputError("port", port, f"at most {LAST_PORT + 1 - len(homes)}: {len(homes)} drones have a port each")
    if mavlink is not None:
        if len(homes) > MAX_VEHICLES:
            raise InputError("count", len(homes), f"at most {MAX_VEHICLES} with --mavlink, one for each system id")
        for name, given in (("radios", radios), ("outside", outside)):
            if given:
                raise InputError(name, None, says="has no effect with --mavlink")
    with _drones(homes, host, port, loss, mavlink, radios, outside=outside) as drones:
        for uri, home in zip(drones.uris, homes, strict=True):
            say(f"{uri} at {', '.join(f'{x:g}' for x in home)}")
        end = math.inf if seconds is None else time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                time.sleep(min(1.0, max(0.0, end - time.monotonic())))
        except KeyboardInterrupt:
            return


def _drones(
    homes: list[Position], host: str, port: int, loss: float, mavlink: str | None, radios: int, *, outside: bool
) -> Drones:
    """The stand-ins, not serving yet."""
    if mavlink is not None:
        from llm_flock_flight._testing.mavlink import AutopilotStandIns

        return AutopilotStandIns(homes, flavour=mavlink, host=host, port=port, loss=loss, lifelike=True)
    from llm_flock_flight._crazyflie.radios import EXCHANGE_S, SETTING_S
    from llm_flock_flight._testing.crtp import ModelledRadio, StandIns

    shared = [ModelledRadio(EXCHANGE_S + SETTING_S, seed=k) for k in range(radios)]
    try:
        return StandIns(homes, host=host, port=port, loss=loss, outside=outside, radios=shared)
    except OSError as error:
        raise InputError("port", port, f"{len(homes)} free UDP ports from there on ({error})") from None


def grid(count: int, spacing_m: float) -> list[Position]:
    """Places on the ground, row by row [m]."""
    side = math.ceil(math.sqrt(count))
    return [(spacing_m * (k % side), spacing_m * (k // side), 0.0) for k in range(count)]


def _from_file(path: Path) -> tuple[str, int, list[Position]]:
    """Host, first port and places of a file's drones, whose ports have to follow one another."""
    from llm_flock_flight._crazyflie.crazyflies_yaml import read_crazyflies
    from llm_flock_flight._crazyflie.link import host_and_port

    drones = read_crazyflies(path)
    host, first = host_and_port(drones[0].uri) or ("", 0)
    for k, drone in enumerate(drones):
        if not drone.uri.startswith("udp://") or host_and_port(drone.uri) != (host, first + k):
            raise InputError(f"robots.{drone.name}.uri", drone.uri, "udp://HOST:PORT, one port after the other")
    return host, first, [drone.home for drone in drones]
