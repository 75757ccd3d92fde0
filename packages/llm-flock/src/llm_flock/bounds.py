"""Limits on what missions, messages, reports and records hold: one table for all. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

MAX_ROBOTS = 2_000
"""Largest team. The figures of a run are exact and examine all pairs of robots: with 1,000 robots, the shape error of
one round can take a minute, and the time grows with about the third power of the team size."""

MAX_OBSTACLES = 500  #: Most obstacles of a mission: each robot examines all of them in each round.
MAX_CORNERS = 1_024  #: Most corners of all polygons of a mission together.
MAX_POLYGON_CORNERS = 128  #: Most corners of one polygon: dividing it takes the cube of their number, here 0.2 s.
MIN_LENGTH = 1e-3  #: Smallest length that a mission accepts [units]: plans are rounded to a thousandth of it.
MAX_PROGRAM_BYTES = 3_072  #: Largest formation program in JSON [bytes], in a file, a model's answer or a message.
MAX_LENGTH = 1e9  #: Largest length in a mission [units]: far more than any arena, and small enough to be squared.

MAX_INTEGER = 2**53  #: The largest whole number that every reader of JSON can hold.
MAX_FIGURE = 1e15  #: Largest figure of a record.
MAX_DISTANCE = 1e12  #: Largest length and time of a record: no trouble for the arithmetic of drawings.
MAX_ROUND = 10**9  #: Largest number of a round.
LATEST = 2**60  #: Above every time of an order: far enough in the future, and below the largest machine integer.
MAX_WORD = 64  #: Longest name or digest in a report [characters].
MAX_ORDER_BYTES = 128  #: Longest order in words that a team judges: votes about it carry it [bytes].
MAX_ORDERS = 16  #: Most orders in words for one mission: any robot may make them up, and each asks all models.
MAX_REASON = 2000  #: Longest reason in a report [characters].
DEEPEST = 32  #: Deepest nesting of free values; those of this program have a quarter of it.

MAX_WAITING = 256
"""Largest team that waits to give all places together, as preferences need: traffic grows with its size squared."""

TIME_OUT = 10
"""Default of the rounds without a heartbeat, by any route, after which a robot counts as dead; some flights leave
every other robot's range for a while."""


def check_plain(value: Any, depth: int = DEEPEST) -> Any:
    """The value, if every reader of JSON can hold it; ValueError for other numbers, and for deeper nesting."""
    if isinstance(value, Mapping | list | tuple):
        if depth == 0:
            raise ValueError("values are nested too deeply")
        for one in cast("list[Any]", value.values() if isinstance(value, Mapping) else value):
            check_plain(one, depth - 1)
    elif isinstance(value, int | float) and not abs(value) <= (2**63 if isinstance(value, int) else 1e300):
        raise ValueError("a number that readers cannot hold")
    elif not isinstance(value, str | int | float | None):
        raise ValueError(f"a value of type {type(value).__name__}")
    return cast("Any", value)


def max_payload_bytes(n_robots: int) -> int:
    """Largest message that a team of N legitimately needs [bytes]."""
    return 4096 + 256 * n_robots


def mission_room(n_robots: int, places: int, dim: int) -> int:
    """Room for a mission's text in the largest message, beside all else at its largest [bytes]."""
    # A point and a bid for each place, a heartbeat and two positions of each robot.
    point = 1 + 9 * dim
    return max_payload_bytes(n_robots) - 261 - (point + 25) * places - (16 + 2 * point) * n_robots


def max_places(n_robots: int, dim: int) -> int:
    """Most places of a mission: messages of a larger one would have less than half a kilobyte for its text."""
    return (mission_room(n_robots, 0, dim) - 512) // (26 + 9 * dim)


MAX_ROUNDS = 100_000
"""Most rounds of a run."""
