"""Closes links of cflib's so that nothing of them goes on.

Its threads ask whether there is a link and then use it, while another thread takes it away: they die, one with a lock
in its hands, and what they print may abort the interpreter as it ends.
"""

from __future__ import annotations

import time
from typing import Any

JOIN_S = 1.5
"""Longest wait for a thread of cflib's to end: it looks once a second [s]."""


class NoLink:
    """Takes the place of cflib's driver in a link that was closed or lost."""

    needs_resending = False

    def send_packet(self, _packet: object) -> None:
        """Drop it."""

    def receive_packet(self, wait: float = 0.0) -> None:
        """Nothing comes."""
        time.sleep(min(0.05, max(0.0, wait)))

    def close(self) -> None:
        """It is closed."""


def shut(cf: Any) -> None:
    """Close a link of cflib's, with everything that it started."""
    link, cf.link = cf.link, NoLink()
    cf.incoming.stop()
    if link is not None:
        link.close()
    with cf._send_lock:  # noqa: SLF001
        for timer in cf._answer_patterns.values():  # noqa: SLF001  # they would send again
            timer.cancel()
        cf._answer_patterns.clear()  # noqa: SLF001
    if cf.incoming.is_alive():
        cf.incoming.join(JOIN_S)
    cf.disconnected.call(cf.link_uri)  # ends cflib's threads for parameters and statistics
