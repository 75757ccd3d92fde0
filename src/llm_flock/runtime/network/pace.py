"""When what is done again and again is done: at fixed moments, each robot at its own.

Robots begin together, when the last of them is there. Without phases all of them would wake in the same millisecond,
speak, and have everybody's words to open: on a machine that they share each would wait for all others' processor time.
"""

from __future__ import annotations

import asyncio
import math


class Beat:
    """Comes once in every period, at the moments `phase_s + k * period_s` of the event loop's clock.

    Whoever is late for a moment waits for the next one: what was missed is not made up for in a hurry. Beats of equal
    period and phase come together, so what is said in them leaves in one piece.

    Args:
        period_s: time between two beats [s].
        phase_s: when one of them is [s].
    """

    def __init__(self, period_s: float, phase_s: float = 0.0) -> None:
        self._period_s, self._phase_s = period_s, phase_s
        self._count = -math.inf

    async def next(self) -> None:
        """Wait for the next beat."""
        loop = asyncio.get_running_loop()
        passed = math.floor((loop.time() - self._phase_s) / self._period_s)
        self._count = max(self._count, passed) + 1  # a timer may be early by a hair, and is not to count twice
        await asyncio.sleep(self._phase_s + self._count * self._period_s - loop.time())


def phase_s(robot: int, n_robots: int, period_s: float) -> float:
    """A robot's share of a period, by its id [s]."""
    return robot / n_robots * period_s
