"""A run is recorded in one MCAP file, written during the run and read by all that shows results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
