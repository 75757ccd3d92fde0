"""One robot's mind, sans-IO: no asyncio, time, random, sockets or files in here."""
