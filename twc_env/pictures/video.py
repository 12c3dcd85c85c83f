"""Record a team as animated GIFs, one per episode; needs Pillow (extra `viz`).

    env = RecordEpisodes(twc_env.parallel_env(render_mode="rgb_array"), "films")

For one robot with velocity actions, gymnasium's `RecordVideo` writes MP4 instead (needs moviepy). It records one image
per action, so use this class with robots=1 for actions that last many time steps, such as `frontier`.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array
from pettingzoo.utils import BaseParallelWrapper

from twc_env.config.checks import whole_number
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.rendering import SIGNAL_OPACITY
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.json_values import check_folder
from twc_env.records.whole_file import whole_file

BLENDS = (0.8, 0.6, 0.4, 0.25, 0.12)
"""Shares of a line's colour where it covers a pixel in part, or fades."""
SIGNAL_STEPS = 24


class RecordEpisodes(BaseParallelWrapper):
    """Writes a film for each episode to a folder, when the episode ends: `twin-01-seed0.gif`, named by map and seed.

    Frames are 960 pixels wide and have a legend; their caption shows the time, how many robots share a map and the
    share of the floor that is mapped correctly. The view widens as soon as a map lies beside the building. Every
    `every`-th time step is recorded, also within long actions, and shown in real time. An episode abandoned before its
    first step leaves no film; one abandoned later leaves a shorter one, to its last step. After `close`, nothing is
    recorded until the next `reset`.
    """

    def __init__(self, env: ExplorationEnv, folder: str | Path, every: int = 2):
        """Raises ConfigError if the environment does not render images or Pillow is missing, DataError if the folder
        is not writable."""
        if not isinstance(getattr(env, "unwrapped", env), ExplorationEnv) or not hasattr(env, "watch"):
            raise ConfigError(
                f"films need the parallel environment; got {type(env).__name__}: wrap twc_env.parallel_env(...), for "
                "one robot with robots=1"
            )
        super().__init__(env)
        if env.render_mode != "rgb_array":
            raise ConfigError(f"films need render_mode='rgb_array'; the environment has {env.render_mode!r}")
        if importlib.util.find_spec("PIL") is None:
            raise ConfigError("films need Pillow: run `pip install 'twc_env[viz]'`")
        check_folder(Path(folder))
        self._team, self._folder, self._every = env, Path(folder), whole_number("every", every, 1)
        self._frames: list[Any] = []
        self._is_late = False
        """Whether time steps were made since the last recorded one."""
        self._name = ""
        """Name of the film of the present episode."""
        self._written: dict[str, int] = {}
        """How many films of each name were written."""
        env.watch(self._look)

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode, and its film."""
        self._write()
        result = super().reset(seed=seed, options=options)
        self._team.watch(self._look)  # again, as closing the environment drops it
        self._shoot()
        return result

    def step(self, actions: Mapping[str, Any]):
        """One step; the last one of an episode writes the film."""
        result = super().step(dict(actions))
        if not self.agents:
            self._write()
        return result

    def close(self) -> None:
        """Write the film of an unfinished episode."""
        self._write()
        super().close()

    def _look(self) -> None:
        episode = self._team.episode
        self._is_late = True
        if episode.steps % self._every == 0 or episode.is_over:
            self._shoot()

    def _shoot(self) -> None:
        picture = self._team.render()
        assert picture is not None
        episode = self._team.episode
        self._name = film_name(episode.floorplan.name, episode.seed)
        self._frames.append(film_frame(picture))
        self._is_late = False

    def _write(self) -> None:
        if self._frames and self._is_late:
            self._shoot()
        frames, self._frames, self._is_late = self._frames, [], False
        if len(frames) < 2:
            return
        name = self._name
        self._written[name] = self._written.get(name, 0) + 1
        if self._written[name] > 1:  # the same building and seed again
            name = name.replace(".gif", f"-{self._written[name]}.gif")
        path = self._folder / name
        duration_ms = round(1000 * self._every * self._team.config.dynamics.time_step_s)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"cannot make the folder {self._folder}: {error.strerror}; choose another") from error
        write_film(path, frames, duration_ms)


def film_frame(picture: Array) -> Any:
    """A picture (height, width, 3) uint8 as a Pillow image of the colours of `_film_colours`."""
    from PIL import Image

    return Image.fromarray(np.ascontiguousarray(picture)).quantize(palette=_film_colours(), dither=Image.Dither.NONE)


@cache
def _film_colours() -> Any:
    """The palette's colours and their blends with the floors that they are drawn on, as the palette of a Pillow image.

    It is the same for all frames: colours chosen for each one would flicker, and lose those of thin lines.
    """
    from PIL import Image

    plain = [palette.rgb(palette.FLOOR), palette.rgb(palette.UNKNOWN)]
    tinted = [palette.tinted_floor(robot) for robot in range(len(palette.ROBOTS))]
    lines = (*palette.ROBOTS, palette.TRUE_WALL, palette.WALL, palette.INK, palette.CLOSURE, palette.PERSON)
    colours = [*plain, *tinted]
    for line in map(palette.rgb, lines):
        colours += [line, *(share * line + (1 - share) * ground for ground in plain for share in BLENDS)]
    for line in map(palette.rgb, (palette.WALL, palette.CLOSURE)):
        colours += [0.5 * line + 0.5 * ground for ground in tinted]
    steps = np.array([palette.rgb(colour) for colour in palette.SIGNAL])
    for share in np.linspace(0, len(steps) - 1, SIGNAL_STEPS):
        signal = [np.interp(share, range(len(steps)), steps[:, k]) for k in range(3)]
        colours += [SIGNAL_OPACITY * np.array(signal) + (1 - SIGNAL_OPACITY) * ground for ground in plain]
    image = Image.new("P", (1, 1))
    image.putpalette(np.array(colours).round().astype(np.uint8).tobytes())
    return image


def film_name(map_name: str, seed: int) -> str:
    """The file name of a film: map and seed."""
    path = Path(map_name)
    stem = path.stem if path.suffix else map_name
    return f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', stem).strip('-') or 'map'}-seed{seed}.gif"


def write_film(path: Path, frames: Sequence[Any], duration_ms: int | list[int]) -> None:
    """Frames as an endless GIF. Raises DataError when the file cannot be written."""
    try:
        with whole_file(path) as beside:
            frames[0].save(beside, save_all=True, append_images=frames[1:], duration=duration_ms, loop=0)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another folder") from error
