"""Additional observations of learning teams: remaining time, return so far, and goals of the robots.

They follow from the robots' own observations and actions, except the return, which only the value function uses. Robots
of one group share their goals, as those of the scripted teams do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

HALF_WAY_M = 10.0
"""Observations show a distance d as d / (d + this)."""
HALF_NEAR_M = 2.0
"""A choice d away from a goal is shown as this / (d + this)."""


class TeamNotes:
    """Additional observations of several teams: row k * robots + r is robot r of team k.

    | block | shape | meaning |
    |---|---|---|
    | `clock` | (1,) | share of time steps remaining |
    | `gained` | (1,) | return since the start of the episode; used by value functions only |
    | `goals` | (slots, 2) | closeness of each frontier to the robot's last goal, and to the nearest goal of its group |

    All methods take the rows of some teams, whose numbers are `teams`; by default of all.
    """

    def __init__(self, teams: int, robots: int, max_cycles: int):
        self._robots, self._max_cycles = robots, max_cycles
        self._all = np.arange(teams)
        self._elapsed = np.zeros(teams * robots)
        self._gained = np.zeros(teams * robots)
        self._goals_m = np.full((teams * robots, 2), np.nan)
        """In the map frame of the robot."""
        self._group_sizes = np.zeros(teams * robots)
        others = [[other for other in range(robots) if other != robot] for robot in range(robots)]
        self._others = np.array(others, int).reshape(robots, robots - 1)

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

    def time_left(self, teams: Array | None = None) -> Array:
        """(rows,) share of the time steps remaining."""
        return 1.0 - self._elapsed[self._rows(teams)] / self._max_cycles

    def note_choices(self, seen: dict[str, Array], actions: Array, teams: Array | None = None) -> None:
        """Record the new goals of the robots; a robot that can only stay is busy and keeps its goal."""
        rows, slots, actions = self._rows(teams), seen["frontiers"].shape[1], np.asarray(actions)
        chosen = np.flatnonzero(seen["action_mask"].sum(axis=1) > 1)
        self._goals_m[rows[chosen]] = np.nan
        bound = chosen[actions[chosen] < slots]
        offsets_m = places_m(seen["frontiers"][bound, actions[bound]])
        pose = seen["pose"][bound].astype(float)
        self._goals_m[rows[bound]] = pose[:, :2] + turned(offsets_m, pose[:, 2], pose[:, 3])

    def note_outcome(
        self,
        time_steps: Array | int,
        rewards: Array | float = 0.0,
        ended: Array | bool = False,
        teams: Array | None = None,
    ) -> None:
        """Record the duration and rewards of a step; the state of ended episodes is reset."""
        rows = self._rows(teams)
        self._elapsed[rows] += time_steps
        self._gained[rows] += rewards
        over = rows[np.broadcast_to(ended, rows.shape)]
        self._elapsed[over] = self._gained[over] = 0.0
        self._goals_m[over] = np.nan
        self._group_sizes[over] = 0.0

    def beside(self, seen: dict[str, Array], teams: Array | None = None) -> dict[str, Array]:
        """The observations with these blocks added."""
        rows = self._rows(teams)
        clock, gained = (each[:, None].astype(np.float32) for each in (self.time_left(teams), self._gained[rows]))
        return {**seen, "clock": clock, "gained": gained, "goals": self._nearness(seen, rows)}

    def arrays(self) -> dict[str, Array]:
        """What `fill` needs to go on."""
        return {name: getattr(self, f"_{name}").copy() for name in ("elapsed", "gained", "goals_m", "group_sizes")}

    def fill(self, arrays: Mapping[str, Array]) -> None:
        """Go on from the `arrays` of other notes of as many teams and robots."""
        for name in self.arrays():
            setattr(self, f"_{name}", arrays[name].copy())

    def _rows(self, teams: Array | None) -> Array:
        teams = self._all if teams is None else teams
        rows: Array = (np.asarray(teams)[:, None] * self._robots + np.arange(self._robots)).ravel()
        return rows

    def _nearness(self, seen: dict[str, Array], rows: Array) -> Array:
        """The block `goals`."""
        sizes = seen["team"][:, :, 0].sum(axis=1)
        self._goals_m[rows[sizes != self._group_sizes[rows]]] = np.nan  # the map frame has changed
        self._group_sizes[rows] = sizes
        pose = seen["pose"].astype(float)
        own_m = turned(self._goals_m[rows] - pose[:, :2], pose[:, 2], -pose[:, 3])  # in each robot's own frame
        choices_m = places_m(seen["frontiers"])  # (rows, slots, 2)
        present = seen["frontiers"][:, :, 0] > 0
        nearness = np.zeros((*present.shape, 2), np.float32)
        nearness[:, :, 0] = near(choices_m, own_m[:, None])
        if self._robots > 1:
            told = seen["team"].astype(float)  # (rows, robots - 1, 5)
            of_teammates_m = own_m.reshape(-1, self._robots, 2)[:, self._others].reshape(len(rows), -1, 2)
            heading = np.pi * told[..., 3]
            goals_m = places_m(told) + turned(of_teammates_m, np.cos(heading), np.sin(heading))
            goals_m[told[..., 0] == 0] = np.nan
            nearness[:, :, 1] = near(choices_m[:, :, None], goals_m[:, None]).max(axis=2)
        nearness[~present] = 0.0
        return nearness


def places_m(rows: Array) -> Array:
    """(..., 2) positions in the robot frame, from rows (..., k) with bearing / pi and d / (d + 10 m) in columns 1 and
    2."""
    bearing, share = np.pi * rows[..., 1].astype(float), np.minimum(rows[..., 2].astype(float), 0.999)
    away = HALF_WAY_M * share / (1.0 - share)
    return np.stack([away * np.cos(bearing), away * np.sin(bearing)], axis=-1)


def turned(offsets: Array, cosine: Array, sine: Array) -> Array:
    """(..., 2) offsets, each turned by its own angle."""
    x, y = offsets[..., 0], offsets[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def near(places: Array, goals: Array) -> Array:
    """Closeness of positions (..., 2) to goals, in [0, 1]; 0 without a goal."""
    away = np.hypot(places[..., 0] - goals[..., 0], places[..., 1] - goals[..., 1])
    return np.nan_to_num(HALF_NEAR_M / (HALF_NEAR_M + away))
