"""Foundations: the types of data, plane geometry, random streams, vehicle dynamics, the reward."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
