"""One run is one MCAP file: written as it happens, read by everything that shows results."""

from __future__ import annotations

RECORD_NAME = "run.mcap"
"""Name of a record in its folder."""

MAGIC = b"\x89MCAP0\r\n"
"""How an MCAP file begins."""
