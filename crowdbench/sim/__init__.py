"""The simulator: pedestrian policies and their kernels, motion, the rule of an episode, and the vehicle's sensor."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
