"""How a record is named, and how its file begins."""

from __future__ import annotations

RECORD_NAME = "run.mcap"
"""Name of a record in its folder."""

MAGIC = b"\x89MCAP0\r\n"
"""How an MCAP file begins."""
