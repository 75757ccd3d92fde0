"""Claims on drones: no two flights of one user on one computer fly the same drone, in any process.

Nothing else keeps a second flight away: a Crazyflie obeys every radio that knows its address. A claim is a locked file,
which the system gives back when the flight's process and its deadman have ended.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote

from llm_flock.errors import InputError
from llm_flock.file_lock import lock_file
from llm_flock_flight._addresses import one_spelling
from llm_flock_flight._crazyflie.link import default_folder
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.sections import DroneConfig

logger = logging.getLogger(__name__)


def claims_folder() -> Path:
    """A folder in this user's cache, beside that of the drones' tables."""
    return default_folder().parent / "flying"


def identity(drone: DroneConfig, *, shared: bool) -> str | None:
    """The identity of a drone on this computer, the same for all spellings of its address; None without an address."""
    if drone.uri is None:
        return None
    address = one_spelling(drone.uri, _resolve)
    return f"{address} {drone.system_id or 1}" if shared else address


def _resolve(host: str) -> str:
    """The address of a host by its name; the name itself if it cannot be resolved."""
    try:
        return str(socket.getaddrinfo(host, None, socket.AF_INET)[0][4][0])
    except (OSError, UnicodeError):
        return host


@contextmanager
def claim_drones(config: FlightConfig, folder: Path | None = None) -> Generator[Sequence[int]]:
    """Claim all drones of a flight, or raise InputError, and give them back; yields the handles of the locked files.

    A process that inherits the handles keeps the drones claimed. Drones simulated in this process need no claim, and
    where the folder cannot be written to there is none, which is logged.
    """
    fleet = config.fleet
    with ExitStack() as stack:
        handles: list[int] = []
        for drone in fleet.drones if fleet.robot not in ("simulated", "physics") else ():
            name = identity(drone, shared=fleet.robot == "mavlink")
            if name is None:
                continue
            try:
                file = _claim((folder or claims_folder()) / quote(name, safe=" "))
            except (OSError, RuntimeError) as error:  # also a user without a home
                logger.warning("%s: another flight of it would not be noticed (%s)", drone.name, error)
                continue
            if file is None:
                raise InputError(
                    "drones",
                    drone.name,
                    says=f"another flight on this computer flies {drone.uri}: let it land first (l in its terminal), "
                    "or give this flight other drones",
                )
            stack.callback(_give_back, file)
            handles.append(file.fileno())
        yield handles


def _claim(path: Path) -> BinaryIO | None:
    """The locked file of a drone; None while another flight has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        file = path.open("ab")
        if not lock_file(file.fileno()):
            file.close()
            return None
        # Whoever had it may have removed the file between its opening and its lock.
        if _same(path, file):
            return file
        file.close()


def _same(path: Path, file: BinaryIO) -> bool:
    with suppress(FileNotFoundError):
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    return False


def _give_back(file: BinaryIO) -> None:
    with file, suppress(OSError):
        Path(file.name).unlink()
