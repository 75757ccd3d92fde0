"""The operator's time of an order: a hybrid logical clock in one number, so that the last order given is the one flown.

Robots take the mission whose order has the highest time, wherever it was given. A count that each robot keeps cannot
tell which of two orders was the later one: it grows faster where more orders arrive. The operator's own clock can. Its
time is that of the wall clock in milliseconds, with `LOGICAL_BITS` for a count: it grows with every order, also where
the wall clock stands still or is set back (Kulkarni, Demirbas, Madappa, Avva, Leone: Logical physical clocks, OPODIS
2014).
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

LOGICAL_BITS = 16
"""Lowest bits of an order's time, which count orders within a millisecond."""

LATEST = 2**60
"""Above every time of an order: far enough in the future, and below the largest machine integer."""

MOST_AHEAD_MS = 24 * 3600 * 1000
"""A time that others tell is believed if it is at most this far ahead of the own clock [ms]; no liar sets the clock."""


def order_time(milliseconds: int, count: int = 0) -> int:
    """The time of an order at this moment [ms], the `count`-th of its millisecond."""
    return (milliseconds << LOGICAL_BITS) + count


class OperatorClock:
    """Gives each order of one operator a higher time than all before; `now_ms` is the wall clock [ms since 1970]."""

    def __init__(self, now_ms: Callable[[], int]) -> None:
        self._now_ms = now_ms
        self._last = 0

    def witness(self, time: int) -> None:
        """Take note of the time of another order, of this operator's in an earlier life for instance."""
        if time <= order_time(self._now_ms() + MOST_AHEAD_MS):
            self._last = max(self._last, time)

    def next(self) -> int:
        """The time of an order that is given now."""
        self._last = max(order_time(self._now_ms()), self._last + 1)
        return self._last


def time_text(time: int) -> str:
    """An order's time in words; the first mission, and rounds of a simulation, count from 1970 too."""
    moment = datetime.fromtimestamp((time >> LOGICAL_BITS) / 1000.0, UTC)
    count = time & ((1 << LOGICAL_BITS) - 1)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 1000:03} UTC" + (f" ({count})" if count else "")
