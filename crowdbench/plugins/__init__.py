"""Plug-ins: Python files and installed packages, loaded by name or path, with their options and digests."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
