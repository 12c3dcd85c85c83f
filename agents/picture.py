"""Pictures of an episode: an annotated map and an animated GIF."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from numpy.typing import NDArray as Array

from twc_env import ConfigError, EpisodeResult
from twc_env.pictures.style import save_figure
from twc_env.pictures.video import film_frame, write_film

FRAME_COUNT_MAX = 160


def require_libraries(gif: bool = True) -> None:
    """Raise ConfigError if a library for pictures is missing."""
    missing = [name for name, module in (("matplotlib", "matplotlib"), ("pillow", "PIL")) if not find_spec(module)]
    if missing and (gif or "matplotlib" in missing):
        raise ConfigError(
            f"pictures need {' and '.join(missing)}: run `pip install 'twc_env[viz]'`, or add --no-pictures"
        )


class Film:
    """Frames of an episode of unknown length: when there are too many, every second one is dropped."""

    def __init__(self, every: int = 5):
        self.every = every
        self._frames: list[Any] = []
        self._steps: list[int] = []

    def wants(self, step: int) -> bool:
        """Whether the frame of this step should be added."""
        return step % self.every == 0

    def add(self, step: int, frame: Array) -> None:
        """Add a frame (height, width, 3) uint8."""
        self._frames.append(film_frame(frame))
        self._steps.append(step)
        if len(self._frames) > FRAME_COUNT_MAX and self.wants(step):  # the last frame may be at any step
            self.every *= 2
            kept = [k for k, s in enumerate(self._steps) if s % self.every == 0]
            self._frames, self._steps = [self._frames[k] for k in kept], [self._steps[k] for k in kept]

    def write(self, path: Path) -> None:
        """Save as a looping GIF with a pause on its last frame."""
        if not self._frames:
            return
        write_film(path, self._frames, [80] * (len(self._frames) - 1) + [2000])


def draw_map(result: EpisodeResult, path: Path, dpi: float | None = None) -> Path:
    """Write the map picture: true walls below the estimated maps, paths, signs, access points and closures.

    The suffix of the path is the format: .png, .pdf or .svg.
    """
    return save_figure(result.plot(), path, dpi)
