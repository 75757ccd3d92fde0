"""Pauses of this process, as when the computer stands still: what came meanwhile has not been read yet."""

from __future__ import annotations

import math
import threading
from functools import cache
from time import monotonic, sleep

LOOK_S = 0.05  # time between two looks at the clock [s]
PAUSE_S = 0.25  # a longer time between two looks was a pause of this process [s]
CATCH_UP_S = 0.5  # time after a pause in which nobody is blamed for a silence [s]


class OwnPauses:
    """Looks at the clock in a thread. `longest_s` is the longest delay of a look since `restart` [s]."""

    def __init__(self) -> None:
        self._looked_s, self._back_s = monotonic(), -math.inf
        self.restart()
        threading.Thread(target=self._watch, name="pauses", daemon=True).start()

    def restart(self) -> None:
        """Measure from now on."""
        self.longest_s, self._began_s = 0.0, monotonic()

    @property
    def measured_for_s(self) -> float:
        """Time since `restart` [s]."""
        return monotonic() - self._began_s

    def catching_up(self) -> bool:
        """Whether this process has stood still so lately that it may not have read all that came."""
        self._look()  # the thread may not have run yet
        return monotonic() - self._back_s < CATCH_UP_S

    def _watch(self) -> None:
        while True:
            sleep(LOOK_S)
            self._look()

    def _look(self) -> None:
        now = monotonic()
        late_s = now - self._looked_s - LOOK_S
        if late_s > PAUSE_S:
            self._back_s = now
        self.longest_s = max(self.longest_s, late_s)
        self._looked_s = now  # last, so that a look of another thread at this moment sees the pause as well


@cache
def own_pauses() -> OwnPauses:
    """Those of this process, watched from the first call on."""
    return OwnPauses()
