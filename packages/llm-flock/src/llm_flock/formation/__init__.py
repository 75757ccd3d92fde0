"""Formations as programs: what to draw is data, and one deterministic rule places any number of robots on it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
