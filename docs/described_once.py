"""An extension of Griffe, which reads the docstrings.

A name is described where it is defined, and not again where it is re-exported.
"""

import griffe


class DescribedOnce(griffe.Extension):
    """Takes re-exports for private."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: object) -> None:
        """Called once, when all of the package is read."""
        self._hide_reexports(pkg)

    def _hide_reexports(self, module: griffe.Module) -> None:
        for member in module.members.values():
            if isinstance(member, griffe.Alias):
                member.public = False
            elif isinstance(member, griffe.Module):
                self._hide_reexports(member)
