"""Plug-ins: Python files and installed packages, found by name or path, with their options and digests."""
