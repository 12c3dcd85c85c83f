"""Angles and directions in loops, without a call of the mathematical library for each, which takes 10 to 20 ns."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel

_TURN = 2.0 * math.pi


@borrowing_kernel
def angle_of(x, y):
    """Angle of (x, y) in [-pi, pi] to 1e-15 rad; branch-free, so that loops of it are vectorised.

    The quotient is reduced to at most 0.66, where the rational approximation of the arc tangent of Moshier's Cephes
    library (1989, atan.c) holds.
    """
    ax, ay = abs(x), abs(y)
    small, large = min(ax, ay), max(max(ax, ay), 1e-300)
    is_wide = small > 0.66 * large
    t = (small - large if is_wide else small) / (small + large if is_wide else large)
    z = t * t
    above = z * (
        -6.485021904942025371773e1
        + z
        * (
            -1.228866684490136173410e2
            + z * (-7.500855792314704667340e1 + z * (-1.615753718733365076637e1 - z * 8.750608600031904122785e-1))
        )
    )
    below = 1.945506571482613964425e2 + z * (
        4.853903996359136964868e2
        + z * (4.328810604912902668951e2 + z * (1.650270098316988542046e2 + z * (2.485846490142306297962e1 + z)))
    )
    angle = t + t * (above / below)
    angle = angle + 0.25 * math.pi if is_wide else angle
    angle = 0.5 * math.pi - angle if ay > ax else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@borrowing_kernel
def wrapped(angle):
    """The angle in [-pi, pi)."""
    return (angle + math.pi) % _TURN - math.pi


@borrowing_kernel
def turn_evenly(angle, step, first, last, cosines, sines):
    """Fill cosines and sines (k,) from index first to last with those of an angle that grows by `step` per index.

    Each direction is one before, turned: 1,000 of them deviate by 1e-13. After the first eight it is that of eight
    before, so that eight are computed at once.
    """
    c, s, turn_c, turn_s = math.cos(angle), math.sin(angle), math.cos(step), math.sin(step)
    for k in range(first, min(first + 8, last + 1)):
        cosines[k], sines[k] = c, s
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
    turn_c, turn_s = math.cos(8.0 * step), math.sin(8.0 * step)
    for k in range(np.uint64(first + 8), np.uint64(max(last + 1, first + 8))):
        c, s = cosines[k - np.uint64(8)], sines[k - np.uint64(8)]
        cosines[k], sines[k] = c * turn_c - s * turn_s, s * turn_c + c * turn_s
