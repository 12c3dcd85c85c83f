"""Knowledge that can be kept from a policy, to measure what it is worth ("ablation").

Only the policy is blind: the environment plays on as it is. So its candidates are still places on the map, and gains
still leave out what teammates in contact go to see.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING

from twc_env.errors import ConfigError, did_you_mean, one_of

if TYPE_CHECKING:
    from torch import Tensor

BEARING_FROM_FRONT, DISTANCE, WAY, SIZE, IS_TEAMMATE_NEARER = range(1, 6)
"""Columns of `frontiers`."""
SIGN, TEAMMATE = -3, -2
"""Columns of `action_mask`: the choices to go to the nearest sign and to the nearest teammate."""


def hidden(seen: dict[str, Tensor], blind: Collection[str]) -> dict[str, Tensor]:
    """The blocks that a policy sees which does not know of `blind`, some of `HIDES`."""
    if not blind:
        return seen
    left = {name: block.clone() for name, block in seen.items()}
    for name in blind:
        HIDES[name](left)
    return left


def check_blind(blind: Collection[str]) -> None:
    """Raise ConfigError unless all are names in `HIDES`."""
    for name in blind:
        if name not in HIDES:
            raise ConfigError(
                f"--blind {name}: nothing of this name is seen{did_you_mean(name, HIDES)}{one_of(name, HIDES)}"
            )


def _hide_teammates(seen: Mapping[str, Tensor]) -> None:
    """Where they are or were last heard, their goals, whether one is nearer to a candidate, how far those of other maps
    are, and to go to one."""
    seen["team"].zero_()
    if "other_maps" in seen:
        seen["other_maps"].zero_()
    seen["goals"][..., 1] = 0.0
    seen["frontiers"][..., IS_TEAMMATE_NEARER] = 0.0
    seen["action_mask"][..., TEAMMATE] = 0.0


def _hide_signs(seen: Mapping[str, Tensor]) -> None:
    """Recent readings, and to go to a sign."""
    if "signs" in seen:
        seen["signs"].zero_()
    seen["action_mask"][..., SIGN] = 0.0


def _hide_map(seen: Mapping[str, Tensor]) -> None:
    """What the map tells of a candidate: gain, size and way. Where it lies remains: its straight line is its way."""
    if "gains" in seen:
        seen["gains"].zero_()
    rows = seen["frontiers"]
    rows[..., WAY], rows[..., SIZE], rows[..., IS_TEAMMATE_NEARER] = rows[..., DISTANCE], 0.0, 0.0


HIDES: dict[str, Callable[[Mapping[str, Tensor]], None]] = {
    "teammates": _hide_teammates, "signs": _hide_signs, "map": _hide_map,
}  # fmt: skip
"""What a policy can be blind for -> what removes it from what is seen."""
