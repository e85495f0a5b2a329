"""crowdbench: the benchmark for navigation in crowds.

The public names are listed in `__init__.pyi`. They are imported when first used, so that `import crowdbench` and the
command line start at once. The environments are registered with Gymnasium and PettingZoo right away.
"""

import importlib.metadata

import lazy_loader

from crowdbench.envs.registration import register

register()

__version__ = importlib.metadata.version("crowdbench")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
