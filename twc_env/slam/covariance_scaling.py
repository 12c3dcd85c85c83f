"""Dynamic covariance scaling of the closures that a map uses, and a whole optimisation with it in one compiled call."""

from __future__ import annotations

import numpy as np

from twc_env.kernels import kernel
from twc_env.slam.relative_equations import relative_squared_errors, sparse_step

FIRST_DAMPING, LAST_DAMPING = 1e-6, 1e-12
"""Of the first step, and the least; a tenth as much after each."""
TRIES, ROUNDING = 8, 1 + 1e-12
"""Dampings that are tried, ten times as much each, until a step does not raise the cost by more than rounding does."""
NEGLIGIBLE, HEARD_SHARE = 1e-6, 0.8
"""Weight from which on down an edge is not heard in a step; where no more than this share is heard, a smaller pattern
pays."""
DECREASE, STALLED_M = 1e-6, 0.1
"""A step shorter than this that takes a smaller share off the error ends an optimisation."""


@kernel
def weights_of_used(squared, is_closure, used, scale):
    """(edges,) dynamic covariance scaling of closures that are used; odometry always 1."""
    weight = np.empty(squared.shape[0])
    for e in range(squared.shape[0]):
        root = min(1.0, 2 * scale / (scale + squared[e])) if is_closure[e] else 1.0
        weight[e] = root * root if used[e] else 0.0
    return weight


@kernel
def minimised_of_used(
    poses, edges, measured, information, is_closure, used, scale, iterations_max, step_m, step_rad, block_of_edge, held,
    order, start, node_of, block_of, target_start, target, block_count,
):  # fmt: skip
    """Poses and squared errors after `NormalEquations.minimise` with `weights_of_used`, for a pattern of which nothing
    is left to be factorised densely; False beside them where a smaller pattern pays: then they are worth nothing.
    """
    damping = FIRST_DAMPING
    squared = relative_squared_errors(poses, edges, measured, information)
    for _ in range(iterations_max):
        weight = weights_of_used(squared, is_closure, used, scale)
        cost, heard = 0.0, 0
        for e in range(len(weight)):
            cost += weight[e] * squared[e]
            heard += weight[e] > NEGLIGIBLE
        if heard <= HEARD_SHARE * len(weight):
            return poses, squared, False
        is_found, moved_m, moved_rad, rest, tried = False, 0.0, 0.0, cost, damping
        for _ in range(TRIES):
            is_sound, moved, moved_m, moved_rad = sparse_step(
                poses, edges, measured, information, weight, block_of_edge, held, order, start, node_of, block_of,
                target_start, target, block_count, tried,
            )  # fmt: skip
            if is_sound:
                its_squared = relative_squared_errors(moved, edges, measured, information)
                rest = 0.0
                for e in range(len(weight)):
                    rest += weight[e] * its_squared[e]
                if rest <= cost * ROUNDING:
                    poses, squared, is_found = moved, its_squared, True
                    break
            tried = max(tried * 10, 1e-9)
        if not is_found:
            break
        damping = max(damping / 10, LAST_DAMPING)
        if (cost - rest < DECREASE * cost and moved_m < STALLED_M) or (moved_m < step_m and moved_rad < step_rad):
            break
    return poses, squared, True
