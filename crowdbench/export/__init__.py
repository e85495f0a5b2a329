"""Export runs: tracks, a replay page, SocNav files and ROS bags."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
