"""Social force model of walking: what accelerates a person towards a place, and away from people, robots and walls.

Helbing and Molnar, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 1995: a person accelerates towards
the speed wanted within a relaxation time, and is never faster than 1.3 times that. The interaction between people is
the one measured by Moussaid et al., "Experimental study of the behavioural mechanisms underlying self-organization in
human crowds", Proc. R. Soc. B 276, 2009 (used again in their "The walking behaviour of pedestrian social groups",
PLoS ONE 5(4), 2010): it decays along and turns around the direction of their relative motion.
"""

from __future__ import annotations

import math

from twc_env.kernels.compiled import borrowing_kernel

RELAXATION_S = 0.54
"""Moussaid et al. 2009: time within which a person reaches the speed wanted."""
SPEED_EXCESS = 1.3
"""Helbing and Molnar 1995: greatest speed, relative to the one wanted."""
STRENGTH_M_S2 = 4.5
"""Moussaid et al. 2009, A; the next four are their gamma, n', n and lambda."""
RANGE_S = 0.35
ANGLE_SLOWING, ANGLE_TURNING = 3.0, 2.0
RELATIVE_MOTION = 2.0
WALL_STRENGTH_M_S2, WALL_RANGE_M = 3.0, 0.1
"""Moussaid et al. 2009, a and b of the repulsion of walls."""
REACH_M = 4.0
"""People further away are ignored: at a relative speed of 2.6 m/s the interaction has fallen to a sixth."""
_RIGHT = 1e-3
"""Who meets somebody head-on evades to the right."""


@borrowing_kernel
def interaction(dx, dy, vx, vy):
    """Acceleration [m/s2] of a person by another at (dx, dy) [m], over whom the person gains with velocity (vx, vy).

    Moussaid et al. 2009, Eq. 4 to 7: D = lambda (v_i - v_j) + e_ij is the direction of the interaction, theta the angle
    between D and e_ij, B = gamma |D|.
    """
    distance = math.sqrt(dx * dx + dy * dy)
    if distance > REACH_M or distance < 1e-9:
        return 0.0, 0.0
    ex, ey = dx / distance, dy / distance
    tx, ty = RELATIVE_MOTION * vx + ex, RELATIVE_MOTION * vy + ey
    size = math.sqrt(tx * tx + ty * ty)
    if size < 1e-9:
        return 0.0, 0.0
    tx, ty, reach = tx / size, ty / size, RANGE_S * size
    theta = math.atan2(tx * ey - ty * ex, tx * ex + ty * ey) + _RIGHT
    decay = STRENGTH_M_S2 * math.exp(-distance / reach)
    slowing = decay * math.exp(-((ANGLE_SLOWING * reach * theta) ** 2))
    turning = decay * math.exp(-((ANGLE_TURNING * reach * theta) ** 2))
    turning = turning if theta > 0.0 else -turning
    # The normal (ty, -tx) points to the right of D: away from somebody on the left.
    return -slowing * tx + turning * ty, -slowing * ty - turning * tx


@borrowing_kernel
def wall_repulsion(gap):
    """Acceleration [m/s2] away from a wall whose distance to the body is `gap` [m]."""
    return WALL_STRENGTH_M_S2 * math.exp(-max(gap, 0.0) / WALL_RANGE_M)
