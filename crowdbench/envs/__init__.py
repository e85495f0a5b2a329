"""PettingZoo and Gymnasium environments: thin layers over the simulator that rollouts use too."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
