"""One robot's decision process, sans-IO: without asyncio, time, random, sockets or files."""
