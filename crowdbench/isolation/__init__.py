"""Planners in separate processes: they receive observations, return commands, and have access to nothing else.

The parent (`planner`) starts the process (`process`), in a sandbox if one is available (`sandbox`), and exchanges
messages with it in a binary format (`protocol`). In the process, `client` constructs the planner and answers messages.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
