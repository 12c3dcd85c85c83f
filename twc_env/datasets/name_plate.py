"""Signs that hang where a map says that a name belongs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.floorplan import SIGN_FACE_M, SIGN_FRONT_M, Floorplan, Sign


def hung_sign(plan: Floorplan, text: str, at: Array, normal: Array) -> Sign | None:
    """A sign there, if open floor lies before it."""
    front = at + SIGN_FRONT_M * normal
    if not plan.cells().is_free(np.stack([front, at + 2 * SIGN_FRONT_M * normal])).all():
        return None
    face = at + SIGN_FACE_M * normal
    if plan.wall_index.crossing(front, face[None])[0][0] or plan.wall_index.distance_m(at[None], 0.3)[0] >= 0.1:
        return None
    return Sign(text, at, float(np.arctan2(normal[1], normal[0])))
