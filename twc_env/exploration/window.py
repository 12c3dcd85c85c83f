"""A window that shows pictures as an episode runs: `render_mode="human"`. Needs pygame (extra `viz`)."""

from __future__ import annotations

import importlib.util
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError


class Window:
    """Opens with its first picture, keeps to a frame rate, and stays shut once its user or `close` has shut it.

    pygame has one window per process: environments with windows run in processes of their own.
    """

    def __init__(self, title: str, frames_per_s: float):
        """Raises ConfigError where pygame is missing; nothing is loaded or opened yet."""
        if importlib.util.find_spec("pygame") is None:
            raise ConfigError(
                "render_mode='human' needs pygame: run `pip install 'twc_env[viz]'`, or choose 'rgb_array'"
            )
        self._title, self._frames_per_s = title, frames_per_s
        self._screen: Any = None
        self._clock: Any = None
        self._keys: list[str] = []
        self.is_shut = False
        self.is_paused = False
        """The user pressed space: whoever draws should wait until it is pressed again."""

    def show(self, picture: Array, title: str = "") -> None:
        """Put a picture (height, width, 3) uint8 on the screen once the last one was there for 1 / rate seconds.

        title: what the window's bar says from now on; empty keeps it.

        Raises ConfigError where there is no display.
        """
        if not self.answer():
            return
        import pygame

        height, width = picture.shape[:2]
        if self._screen is None or self._screen.get_size() != (width, height):
            self._open(width, height)
        if title:
            pygame.display.set_caption(title)
        self._screen.blit(pygame.surfarray.make_surface(np.swapaxes(picture, 0, 1)), (0, 0))
        self._clock.tick(self._frames_per_s)
        pygame.display.flip()

    def answer(self) -> bool:
        """Take in what the user did to the window; False once it is shut."""
        if self._screen is not None:
            import pygame

            for event in pygame.event.get():
                if event.type == pygame.QUIT:
                    self.close()
                    break
                if event.type == pygame.KEYDOWN and event.unicode == " ":
                    self.is_paused = not self.is_paused
                elif event.type == pygame.KEYDOWN:
                    self._keys.append(event.unicode)
        return not self.is_shut

    def take_keys(self) -> list[str]:
        """The keys pressed since the last call, as characters, in their order."""
        keys, self._keys = self._keys, []
        return keys

    def wait(self) -> None:
        """Let a twentieth of a second pass."""
        import pygame

        pygame.time.wait(50)

    def close(self) -> None:
        """Shut the window for good; a window that is not open stays so."""
        self.is_shut = True
        if self._screen is not None:
            import pygame

            self._screen, self.is_paused = None, False
            pygame.display.quit()

    def _open(self, width: int, height: int) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        try:
            pygame.display.init()
            self._screen = pygame.display.set_mode((width, height))
        except pygame.error as error:
            raise ConfigError(
                f"no window can be opened here ({error}); set DISPLAY, or choose render_mode='rgb_array'"
            ) from error
        pygame.display.set_caption(self._title)
        self._clock = pygame.time.Clock()
