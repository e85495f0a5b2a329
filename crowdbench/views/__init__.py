"""Observations and actions of learned policies: views of a world in a frame, as arrays."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
