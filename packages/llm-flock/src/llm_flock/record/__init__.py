"""One run is one MCAP file: written as it happens, read by everything that shows results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
