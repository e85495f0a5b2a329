"""Shows pictures in a window, for the render mode `human`."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from jaxtyping import UInt8


class Window:
    """A window, which opens with the first picture. pygame is imported then."""

    def __init__(self) -> None:
        self._display: Any = None
        self._clock: Any = None

    def show(self, picture: UInt8[np.ndarray, "height width 3"], seconds: float) -> None:
        """Show a picture, and wait until it has been shown for some seconds."""
        pygame = importlib.import_module("pygame")
        if self._display is None:
            pygame.display.init()
            self._display = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
            pygame.display.set_caption("crowdbench")
            self._clock = pygame.time.Clock()
        self._display.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(1.0 / seconds)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._display is not None:
            importlib.import_module("pygame").display.quit()
            self._display = None
