"""Plug-ins: Python files and installed packages, loaded by name or path, with their options and digests."""
