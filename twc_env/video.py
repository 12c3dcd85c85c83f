"""Films of a team, one animated GIF per episode; needs Pillow (extra `viz`).

    env = RecordEpisodes(twc_env.parallel_env(render_mode="rgb_array"), "films")

For one robot, gymnasium's own `RecordVideo` does the same as MP4 (it needs moviepy).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pettingzoo.utils import BaseParallelWrapper

from twc_env.config.checks import whole_number
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.film import film_frame, write_film

WIDTH_MAX_PX = 560


class RecordEpisodes(BaseParallelWrapper):
    """Writes `episode-0.gif`, `episode-1.gif`, ... into a folder, each when its episode ends.

    Under each picture stand the time, how many robots share a map and how much of the floor is mapped rightly.
    Every `every`-th step is filmed and shown for as long as these steps last, where every step is one time step. An
    episode that is left before its first step leaves no film; one that is left in the middle a shorter one.
    """

    def __init__(self, env: ExplorationEnv, folder: str | Path, every: int = 2):
        """Raises ConfigError for an environment without pictures or where Pillow is missing."""
        super().__init__(env)
        if env.render_mode != "rgb_array":
            raise ConfigError(f"films need render_mode='rgb_array'; the environment has {env.render_mode!r}")
        if importlib.util.find_spec("PIL") is None:
            raise ConfigError("films need Pillow: run `pip install 'twc_env[viz]'`")
        self._team, self._folder, self._every = env, Path(folder), whole_number("every", every, 1)
        self._frames: list[Any] = []
        self._steps = self._episodes = 0

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode, and its film."""
        self._write()
        result = super().reset(seed=seed, options=options)
        self._steps = 0
        self._shoot()
        return result

    def step(self, actions: Mapping[str, Any]):
        """One step; the last of an episode writes the film."""
        result = super().step(dict(actions))
        self._steps += 1
        if self._steps % self._every == 0 or not self.agents:
            self._shoot()
        if not self.agents:
            self._write()
        return result

    def close(self) -> None:
        """Write what was filmed of an episode that has not ended."""
        self._write()
        super().close()

    def _shoot(self) -> None:
        picture = self._team.render()
        assert picture is not None
        self._frames.append(film_frame(picture, self._team.episode.caption(), WIDTH_MAX_PX))

    def _write(self) -> None:
        frames, self._frames = self._frames, []
        if len(frames) < 2:
            return
        path = self._folder / f"episode-{self._episodes}.gif"
        self._episodes += 1
        duration_ms = round(1000 * self._every * self._team.config.dynamics.time_step_s)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"cannot make the folder {self._folder}: {error.strerror}; choose another") from error
        write_film(path, frames, duration_ms)
