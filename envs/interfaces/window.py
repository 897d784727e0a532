"""A window for the render mode "human". It uses pygame, which is imported when the window opens."""

from __future__ import annotations

from typing import Any

import numpy as np

FRAMES_PER_SECOND = 4
"""Slow enough to follow every step; also the `render_fps` of the environments."""


class Window:
    """A window that shows frames.

    Raises
    ------
    ImportError
        If pygame is not installed.
    """

    def __init__(self, title: str, width: int, height: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise ImportError('the render mode "human" needs pygame; install it with `pip install pygame`') from error
        self._pygame: Any = pygame
        pygame.display.init()
        pygame.display.set_caption(title)
        self._screen = pygame.display.set_mode((width, height))
        self._clock = pygame.time.Clock()

    def show(self, frame: np.ndarray) -> None:
        """Show a frame (height, width, 3) and wait for its share of a second."""
        # pygame counts columns first, arrays count rows first.
        surface = self._pygame.surfarray.make_surface(np.swapaxes(frame, 0, 1))
        self._screen.blit(surface, (0, 0))
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(FRAMES_PER_SECOND)

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()
