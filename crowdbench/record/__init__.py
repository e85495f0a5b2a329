"""Recordings of episodes in Rerun's format: written, read back and viewed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
