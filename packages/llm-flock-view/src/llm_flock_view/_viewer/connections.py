"""Connections of the viewer's server: few enough that file handles are left, each with a limited time to ask."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_CONNECTIONS = 400  # a class of 30 needs 200; systems give a process 1,024 handles
HEAD_S = 5.0  # longest time that the head of a request may take, twice as long after others [s]


class PatientConnection(H11Protocol):
    """Closes itself if it is one too many, or if no whole request comes."""

    def connection_made(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        if len(self.connections) > MAX_CONNECTIONS:
            transport.close()
        else:
            self.loop.call_later(HEAD_S, self._look, None)

    def _look(self, before: object) -> None:
        """Close the connection if it waits for the same request as at the last look."""
        cycle: object = self.cycle  # None before the first request
        if cycle is before and getattr(cycle, "response_complete", True):
            self.transport.close()
        elif not self.transport.is_closing():
            self.loop.call_later(HEAD_S, self._look, cycle)
