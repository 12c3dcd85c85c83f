"""A window that shows pictures of a running episode: `render_mode="human"`. Needs pygame (extra `viz`)."""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError
from twc_env.exploration.drawing.layers import HELP


class Window:
    """Opens with its first picture, limits the frame rate, and never opens again once its user or `close` closed it.

    pygame has one window per process: environments with windows need separate processes.
    """

    def __init__(self, title: str, frames_per_s: float):
        """Raises ConfigError if pygame is missing. Neither imports pygame nor opens the window."""
        if importlib.util.find_spec("pygame") is None:
            raise ConfigError(
                "render_mode='human' needs pygame: run `pip install 'twc_env[viz]'`, or choose 'rgb_array'"
            )
        self._title = title
        self.frames_per_s = frames_per_s
        """Most pictures per second; 0: as many as there are."""
        self.help_text = HELP
        """Shown below the picture."""
        self.held: set[str] = set()
        """The arrow keys that are held down: up, down, left, right."""
        self.tabs = 0
        """How often the tab key was pressed."""
        self._screen: Any = None
        self._clock: Any = None
        self._keys: list[str] = []
        self.is_shut = False
        self.is_paused = False
        """Toggled by the space key; the caller should wait while it is True."""

    def show(self, picture: Array, title: str = "") -> None:
        """Show a picture (height, width, 3) uint8, at least 1 / `frames_per_s` after the last one; nothing if closed.

        title: new title of the window; empty keeps it. Raises ConfigError without a display.
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
        self._clock.tick(self.frames_per_s)
        pygame.display.flip()

    def answer(self) -> bool:
        """Process the events of the window; False once it is closed."""
        if self._screen is not None:
            import pygame

            for event in pygame.event.get():
                if event.type == pygame.QUIT:
                    self.close()
                    break
                arrow = {pygame.K_UP: "up", pygame.K_DOWN: "down", pygame.K_LEFT: "left", pygame.K_RIGHT: "right"}
                if event.type in (pygame.KEYDOWN, pygame.KEYUP) and event.key in arrow:
                    change = self.held.add if event.type == pygame.KEYDOWN else self.held.discard
                    change(arrow[event.key])
                elif event.type == pygame.KEYDOWN and event.key == pygame.K_TAB:
                    self.tabs += 1
                elif event.type == pygame.KEYDOWN and event.unicode == " ":
                    self.is_paused = not self.is_paused
                elif event.type == pygame.KEYDOWN:
                    self._keys.append(event.unicode)
        return not self.is_shut

    def take_keys(self) -> list[str]:
        """The keys pressed since the last call, as characters, in order."""
        keys, self._keys = self._keys, []
        return keys

    def wait(self) -> None:
        """Wait 50 ms."""
        import pygame

        pygame.time.wait(50)

    def close(self) -> None:
        """Close the window; it never opens again."""
        self.is_shut = True
        if self._screen is not None:
            import pygame

            self._screen, self.is_paused = None, False
            pygame.display.quit()

    def _open(self, width: int, height: int) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        named = {name for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER") if os.environ.get(name)}
        try:
            if sys.platform == "linux" and not named:  # where it looks for one, SDL itself prints a line
                raise pygame.error("there is no display, so nobody would see it")
            pygame.display.init()
            if pygame.display.get_driver() == "offscreen" and "SDL_VIDEODRIVER" not in named:
                raise pygame.error("there is no display, so nobody would see it")
            self._screen = pygame.display.set_mode((width, height))
        except pygame.error as error:
            raise ConfigError(
                f"no window can be opened here ({error}); set DISPLAY, or choose render_mode='rgb_array' "
                "(on the command line: twc-env explore draws a film)"
            ) from error
        pygame.display.set_caption(self._title)
        self._clock = pygame.time.Clock()
