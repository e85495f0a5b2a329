"""Training of networks: a file for each method, their options in `config`, and one `runner`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
