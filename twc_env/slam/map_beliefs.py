"""What robots believe who share maps: the records of `TeamBeliefs`, made where somebody asks for one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.messages import Belief, GridMap
from twc_env.slam.radio_structure import RadioPicture
from twc_env.team_messages import KnownSigns, TeamBeliefs, read_only

_NO_PLACES = np.zeros((0, 2))
_NO_PLACES.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False)
class HeldMaps:
    """The maps that robots believe in: of each robot the one of its group."""

    grids: list[GridMap]
    signs: list[KnownSigns]
    versions: list[int]
    radio: list[RadioPicture | None]


class MapBeliefs(TeamBeliefs):
    """Arrays as in `TeamBeliefs`; the map of each robot, the step and the scan that it saw last."""

    __slots__ = ("_maps", "_ranges_m", "_steps")

    def __init__(
        self, poses: Array, since_closure_m: Array, maps: HeldMaps, mates: Array, mate_poses: Array,
        contact_steps: Array, steps: Sequence[int], ranges_m: Sequence[Array] | Array,
    ):  # fmt: skip
        # Instead of the parent's: made in every step.
        self._records, self._maps, self._steps, self._ranges_m = None, maps, steps, ranges_m
        self.poses, self.since_closure_m, self.grids, self.signs = poses, since_closure_m, maps.grids, maps.signs
        self.mates, self.mate_poses, self.contact_steps = mates, mate_poses, contact_steps

    def _make(self) -> list[Belief]:
        beliefs, since_m, maps, poses = [], self.since_closure_m.tolist(), self._maps, read_only(self.poses)
        for robot, radio in enumerate(maps.radio):
            in_map, std, in_odom = poses[robot]
            belief = Belief(
                robot, self._steps[robot], in_map, maps.grids[robot], self.mates_of(robot), maps.signs[robot].records,
                self._ranges_m[robot], maps.versions[robot], in_odom, std, since_m[robot],
                self.contact_steps_of(robot), None if radio is None else radio.grid,
                _NO_PLACES if radio is None else radio.transmitter_m,
            )  # fmt: skip
            beliefs.append(belief)
        return beliefs
