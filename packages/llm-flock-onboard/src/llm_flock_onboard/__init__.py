"""A small language model on board: its engine, its adapter, and how it is distilled."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
