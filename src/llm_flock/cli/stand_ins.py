"""`llm-flock stand-ins`: try a flight without drones."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from llm_flock.cli.terminal import say
from llm_flock.errors import InputError
from llm_flock.robots.base import Position


def stand_ins(
    count: Annotated[int, typer.Argument(min=1, help="Number of drones; with --crazyflies, those of the file")] = 1,
    port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the first; the others follow")] = 19850,
    spacing: Annotated[float, typer.Option(min=0.01, help="Spacing of the drones' square grid [m]")] = 1.0,
    crazyflies: Annotated[
        Path | None, typer.Option(help="Stand in for each enabled udp:// robot of this crazyflies.yaml")
    ] = None,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of packets lost, in each direction")] = 0.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time [default: run until Ctrl-C] [s]")
    ] = None,
) -> None:
    """Stand in for Crazyflies: point masses that speak their protocol over UDP, for flights without hardware."""
    from llm_flock.testing.crtp import StandIns

    host = "127.0.0.1"
    if crazyflies is None:
        homes = grid(count, spacing)
    else:
        host, port, homes = _from_file(crazyflies)
    try:
        drones = StandIns(homes, host=host, port=port, loss=loss)
    except OSError as error:
        raise InputError("port", port, f"{len(homes)} free UDP ports from there on ({error})") from None
    with drones:
        for uri, home in zip(drones.uris, homes, strict=True):
            say(f"{uri} at {', '.join(f'{x:g}' for x in home)}")
        end = math.inf if seconds is None else time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                time.sleep(min(1.0, max(0.0, end - time.monotonic())))
        except KeyboardInterrupt:
            return


def grid(count: int, spacing_m: float) -> list[Position]:
    """Places on the ground, row by row [m]."""
    side = math.ceil(math.sqrt(count))
    return [(spacing_m * (k % side), spacing_m * (k // side), 0.0) for k in range(count)]


def _from_file(path: Path) -> tuple[str, int, list[Position]]:
    """Host, first port and places of a file's drones, whose ports have to follow one another."""
    from llm_flock.robots.crazyflie.crazyflies_yaml import read_crazyflies

    drones = read_crazyflies(path)
    parts = [urlsplit(drone.uri) for drone in drones]
    first = parts[0]
    for k, (drone, part) in enumerate(zip(drones, parts, strict=True)):
        follows = part.scheme == "udp" and part.hostname == first.hostname and part.port == (first.port or 0) + k
        if not follows or part.hostname is None or part.port is None:
            raise InputError(f"robots.{drone.name}.uri", drone.uri, "udp://HOST:PORT, one port after the other")
    return str(first.hostname), int(first.port or 0), [drone.home for drone in drones]
