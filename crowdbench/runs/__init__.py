"""Runs: drive a planner through cases, measure and store the episodes, and compare and replay stored runs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
