"""Additional observations of learning teams: remaining time, return so far, and goals of the robots.

They follow from the robots' own observations and actions, except the return, which only the value function uses. Robots
of one group share their goals, as those of the scripted teams do.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array
from stable_baselines3.common.vec_env import VecEnvWrapper

from twc_env.vector.sb3 import TeamVecEnv

HALF_WAY_M = 10.0
"""Observations show a distance d as d / (d + this)."""
HALF_NEAR_M = 2.0
"""A choice d away from a goal is shown as this / (d + this)."""


class TeamNotes:
    """Additional observations of several teams: row k * robots + r is robot r of team k.

    | block | shape | meaning |
    |---|---|---|
    | `clock` | (1,) | share of time steps remaining |
    | `gained` | (1,) | return since the start of the episode; used by the value function only |
    | `goals` | (slots, 2) | closeness of each frontier to the robot's last goal, and to the nearest goal of its group |
    """

    def __init__(self, teams: int, robots: int, max_cycles: int):
        self._shape, self._max_cycles = (teams, robots), max_cycles
        self._elapsed = np.zeros(teams * robots)
        self._gained = np.zeros(teams * robots)
        self._goals_m = np.full((teams * robots, 2), np.nan)
        """In the map frame of the robot."""
        self._group_sizes = np.zeros(teams * robots)

    @staticmethod
    def space(observed: spaces.Space) -> spaces.Dict:
        """The observation space with these blocks added."""
        assert isinstance(observed, spaces.Dict)
        slots = (observed["frontiers"].shape or ())[0]
        return spaces.Dict(
            {
                **observed.spaces,
                "clock": spaces.Box(0.0, 1.0, (1,), np.float32),
                "gained": spaces.Box(-np.inf, np.inf, (1,), np.float32),
                "goals": spaces.Box(0.0, 1.0, (slots, 2), np.float32),
            }
        )

    def note_choices(self, seen: dict[str, Array], actions: Array) -> None:
        """Record the new goals of the robots; a robot that can only stay is busy and keeps its goal."""
        slots = seen["frontiers"].shape[1]
        chosen = np.flatnonzero(seen["action_mask"].sum(axis=1) > 1)
        self._goals_m[chosen] = np.nan
        bound = chosen[np.asarray(actions)[chosen] < slots]
        offsets_m = places_m(seen["frontiers"][bound, np.asarray(actions)[bound]])
        pose = seen["pose"][bound].astype(float)
        self._goals_m[bound] = pose[:, :2] + turned(offsets_m, pose[:, 2], pose[:, 3])

    def note_outcome(self, time_steps: Array | int, rewards: Array | float = 0.0, ended: Array | bool = False) -> None:
        """Record the duration and rewards of a step; the state of ended episodes is reset."""
        self._elapsed += time_steps
        self._gained += rewards
        self._elapsed[ended] = self._gained[ended] = 0.0
        self._goals_m[ended] = np.nan
        self._group_sizes[ended] = 0.0

    def beside(self, seen: dict[str, Array]) -> dict[str, Array]:
        """The observations with these blocks added."""
        clock = 1.0 - self._elapsed / self._max_cycles
        blocks = {"clock": clock[:, None].astype(np.float32), "gained": self._gained[:, None].astype(np.float32)}
        return {**seen, **blocks, "goals": self._nearness(seen)}

    def _nearness(self, seen: dict[str, Array]) -> Array:
        """The block `goals`."""
        sizes = seen["team"][:, :, 0].sum(axis=1)
        self._goals_m[sizes != self._group_sizes] = np.nan  # the map frame has changed
        self._group_sizes = sizes
        pose, teams, robots = seen["pose"].astype(float), *self._shape
        own_m = turned(self._goals_m - pose[:, :2], pose[:, 2], -pose[:, 3])  # in each robot's own frame
        choices_m = places_m(seen["frontiers"])  # (rows, slots, 2)
        present = seen["frontiers"][:, :, 0] > 0
        nearness = np.zeros((*present.shape, 2), np.float32)
        nearness[:, :, 0] = near(choices_m, own_m[:, None])
        for robot in range(robots):
            rows = np.arange(teams) * robots + robot
            for teammate in (teammate for teammate in range(robots) if teammate != robot):
                told = seen["team"][rows, teammate if teammate < robot else teammate - 1].astype(float)
                heading = np.pi * told[:, 3]
                goals_m = places_m(told) + turned(own_m[rows - robot + teammate], np.cos(heading), np.sin(heading))
                goals_m[told[:, 0] == 0] = np.nan
                nearness[rows, :, 1] = np.maximum(nearness[rows, :, 1], near(choices_m[rows], goals_m[:, None]))
        nearness[~present] = 0.0
        return nearness


class NotedTeams(VecEnvWrapper):
    """Adds the observations of `TeamNotes`, and treats the time limit as the end of the episode.

    The area mapped by then is the score, so there is no return after it. Without the clock, a choice that takes long
    would seem to cost nothing.
    """

    def __init__(self, teams: TeamVecEnv, max_cycles: int):
        super().__init__(teams, TeamNotes.space(teams.observation_space))
        self._new_notes = partial(TeamNotes, teams.num_envs // teams.robots, teams.robots, max_cycles)

    def reset(self):
        """Reset the teams and the added observations."""
        self.notes, self.seen = self._new_notes(), self.venv.reset()
        return self.notes.beside(self.seen)

    def step_async(self, actions):
        """Send actions to the teams, and record the goals."""
        self.notes.note_choices(self.seen, actions)
        self.venv.step_async(actions)

    def step_wait(self):
        """Results of the teams, without `TimeLimit.truncated`, so that no value is added at the time limit."""
        self.seen, rewards, dones, infos = self.venv.step_wait()
        self.notes.note_outcome(np.array([info["time_steps"] for info in infos]), rewards, dones)
        for info in infos:
            info.pop("TimeLimit.truncated", None)
        return self.notes.beside(self.seen), rewards, dones, infos


def places_m(rows: Array) -> Array:
    """(..., 2) positions in the robot frame, from rows (..., k) with bearing / pi and d / (d + 10 m) in columns 1 and
    2."""
    bearing, share = np.pi * rows[..., 1].astype(float), np.minimum(rows[..., 2].astype(float), 0.999)
    away = HALF_WAY_M * share / (1.0 - share)
    return np.stack([away * np.cos(bearing), away * np.sin(bearing)], axis=-1)


def turned(offsets: Array, cosine: Array, sine: Array) -> Array:
    """(n, 2) offsets, each turned by its own angle."""
    x, y = offsets[:, 0], offsets[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def near(places: Array, goals: Array) -> Array:
    """Closeness of positions (..., 2) to goals, in [0, 1]; 0 without a goal."""
    away = np.hypot(places[..., 0] - goals[..., 0], places[..., 1] - goals[..., 1])
    return np.nan_to_num(HALF_NEAR_M / (HALF_NEAR_M + away))
