"""Scenarios: their cases, the random draw of each case, and the TOML files that define them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
