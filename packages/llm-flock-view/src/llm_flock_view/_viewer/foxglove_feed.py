"""Shows the viewer's newest run in Foxglove too: a finished record again and again, a growing one as it grows."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from llm_flock.errors import FlockError
from llm_flock.record import RecordStream, RoundEnd
from llm_flock_view._viewer.library import POLL_S, Library
from llm_flock_view._viewer.recording import Recording

if TYPE_CHECKING:
    from llm_flock_view._foxglove.server import FoxgloveServer

PACE = 2.0  # rounds a second of a finished record
END_S = 3.0  # time for which the end of a record is shown before it begins again [s]


class Feed:
    """Writes the newest recorded run of a library to Foxglove's server. Call `run` in a thread."""

    def __init__(self, library: Library, server: FoxgloveServer) -> None:
        self._library = library
        self._server = server

    def run(self) -> None:
        while True:
            recording = self._library.newest
            if recording is None or recording.path is None:
                time.sleep(POLL_S)
                continue
            self._server.restart()
            try:
                self._show(recording)
            except FlockError:  # the page says what is wrong with the record
                self._wait(recording, float("inf"))
            self._wait(recording, END_S if not recording.live else float("inf"))

    def _show(self, recording: Recording) -> None:
        """Write a run to its end, or until another one is newer."""
        assert recording.path is not None
        stream = RecordStream(recording.path)
        while self._library.newest is recording:
            last = not recording.open or not recording.live  # asked first: what was written before is still read
            for entry in stream.entries():
                self._server.write(entry)
                if isinstance(entry, RoundEnd) and not recording.live:
                    time.sleep(1.0 / PACE)
                    if self._library.newest is not recording:
                        return
            if last or stream.ended:
                return
            time.sleep(POLL_S)

    def _wait(self, recording: Recording, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end and self._library.newest is recording:
            time.sleep(POLL_S)
