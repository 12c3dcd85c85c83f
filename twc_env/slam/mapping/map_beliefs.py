"""The beliefs of robots that share maps. `Belief` records are built only when one is requested."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Belief, GridMap
from twc_env.records.team_messages import KnownSigns, TeamBeliefs, read_only
from twc_env.slam.walls.radio_structure import RadioPicture

_NO_PLACES = np.zeros((0, 2))
_NO_PLACES.flags.writeable = False


HeldMaps = tuple[list[GridMap], list[KnownSigns], list[int], list[RadioPicture | None]]
"""Per robot, from the map of its group: occupancy grid, known signs, map version, radio structure (None without one).
"""


class MapBeliefs(TeamBeliefs):
    """Arrays as in `TeamBeliefs`, and per robot its group's map, last step and last scan [m]."""

    __slots__ = ("_maps", "_ranges_m", "_steps")

    def __init__(
        self, poses: Array, since_closure_m: Array, maps: HeldMaps, teammates: Array, teammate_poses: Array,
        contact_steps: Array, steps: Sequence[int], ranges_m: Sequence[Array] | Array,
    ):  # fmt: skip
        # Replaces the parent's constructor: this object is built in every step.
        self._records, self._maps, self._steps, self._ranges_m = None, maps, steps, ranges_m
        self.poses, self.since_closure_m, self.grids, self.signs = poses, since_closure_m, maps[0], maps[1]
        self.teammates, self.teammate_poses, self.contact_steps = teammates, teammate_poses, contact_steps

    @property
    def map_versions(self) -> Sequence[int]:
        """As in `TeamBeliefs`."""
        return self._maps[2]

    @property
    def ranges_m(self) -> Sequence[Array] | Array:
        """As in `TeamBeliefs`."""
        return self._ranges_m

    def _make(self) -> list[Belief]:
        beliefs, since_m, poses = [], self.since_closure_m.tolist(), read_only(self.poses)
        for robot, (grid, signs, version, radio) in enumerate(zip(*self._maps, strict=True)):
            in_map, std, in_odom = poses[robot]
            belief = Belief(
                robot, self._steps[robot], in_map, grid, self.teammates_of(robot), signs.records,
                self._ranges_m[robot], version, in_odom, std, since_m[robot],
                self.contact_steps_of(robot), None if radio is None else radio.grid,
                _NO_PLACES if radio is None else radio.transmitter_m,
            )  # fmt: skip
            beliefs.append(belief)
        return beliefs
