"""What robots believe who share maps: the records of `TeamBeliefs`, made where somebody asks for one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.messages import Belief, GridMap, KnownSign
from twc_env.slam.radio_structure import RadioPicture
from twc_env.team_messages import TeamBeliefs

Array = NDArray

_NO_PLACES = np.zeros((0, 2))
_NO_PLACES.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The map that one robot believes in."""

    grid: GridMap
    signs: tuple[KnownSign, ...]
    mates: dict[int, Array]
    """Other robots of the map -> (3,) where they are in it."""
    version: int
    radio: RadioPicture | None


class MapBeliefs(TeamBeliefs):
    """`poses` and `since_closure_m` as in `TeamBeliefs`; the step and scan that each robot saw last, and its map."""

    __slots__ = ("_held", "_ranges_m", "_steps")

    def __init__(
        self,
        poses: Array,
        since_closure_m: Array,
        contact_steps: Sequence[dict[int, int]],
        held: Sequence[Held],
        steps: Sequence[int],
        ranges_m: Sequence[Array],
    ):
        grids, signs, mates = [h.grid for h in held], [h.signs for h in held], [h.mates for h in held]
        super().__init__(poses, since_closure_m, grids, signs, mates, contact_steps)
        self._held, self._steps, self._ranges_m = held, steps, ranges_m

    def _make(self) -> list[Belief]:
        beliefs, since_m = [], self.since_closure_m.tolist()
        for robot, held in enumerate(self._held):
            in_map, std, in_odom = self.poses[robot]
            belief = Belief(
                robot,
                self._steps[robot],
                in_map,
                held.grid,
                held.mates,
                held.signs,
                self._ranges_m[robot],
                held.version,
                in_odom,
                std,
                since_m[robot],
                self.contact_steps[robot],
                None if held.radio is None else held.radio.grid,
                _NO_PLACES if held.radio is None else held.radio.transmitter_m,
            )
            beliefs.append(belief)
        return beliefs
