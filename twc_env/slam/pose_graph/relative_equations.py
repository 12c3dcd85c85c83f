"""Compiled equations of relative pose edges: residuals as in g2o's EDGE_SE2, their derivatives, and damped steps."""

from __future__ import annotations

import numpy as np

from twc_env.kernels.compiled import kernel
from twc_env.slam.pose_graph.block_cholesky import factorise, substitute_back


@kernel
def wrapped(angle):
    """The angle moved into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@kernel
def relative_residuals(poses, edges, measured):
    """(edges, 3) measured^-1 (a^-1 b) for edges (edges, 2) of indices a, b."""
    out = np.empty((len(edges), 3))
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        heading, zx, zy, turn = poses[a, 2], measured[e, 0], measured[e, 1], measured[e, 2]
        c, s, cz, sz = np.cos(heading), np.sin(heading), np.cos(turn), np.sin(turn)
        dx, dy = poses[b, 0] - poses[a, 0], poses[b, 1] - poses[a, 1]
        ex, ey = c * dx + s * dy - zx, -s * dx + c * dy - zy
        out[e, 0], out[e, 1], out[e, 2] = cz * ex + sz * ey, -sz * ex + cz * ey, wrapped(poses[b, 2] - heading - turn)
    return out


@kernel
def relative_squared_errors(poses, edges, measured, information):
    """(edges,) squared Mahalanobis length of each residual."""
    out = np.empty(len(edges))
    r = relative_residuals(poses, edges, measured)
    for e in range(len(edges)):
        x, y, t = r[e, 0], r[e, 1], r[e, 2]
        out[e] = (
            x * (information[e, 0, 0] * x + information[e, 0, 1] * y + information[e, 0, 2] * t)
            + y * (information[e, 1, 0] * x + information[e, 1, 1] * y + information[e, 1, 2] * t)
            + t * (information[e, 2, 0] * x + information[e, 2, 1] * y + information[e, 2, 2] * t)
        )
    return out


@kernel
def linearise_relative(poses, edges, measured, information, weight, block_of_edge, block_count, held):
    """Hessian blocks and negative gradient of half the weighted squared errors.

    A block holds H[larger index, smaller index].

    Fixed poses `held` (k,) have unit blocks and zero gradient. The residual's derivatives by the two poses are A = (-R,
    d; 0, -1) and B = (R, 0; 0, 1) with a rotation R. So the first two rows of A^T O are the negative of those of B^T O,
    and all blocks follow from B^T O A and B^T O B.
    """
    diagonal, blocks = np.zeros((len(poses), 3, 3)), np.zeros((block_count, 3, 3))
    gradient = np.zeros((len(poses), 3))
    r = relative_residuals(poses, edges, measured)
    for e in range(len(edges)):
        w = weight[e]
        if w == 0.0:
            continue
        i, j = edges[e, 0], edges[e, 1]
        angle = poses[i, 2] + measured[e, 2]
        c, s = np.cos(angle), np.sin(angle)
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        d0, d1 = -s * dx + c * dy, -c * dx - s * dy
        o00, o01, o02 = w * information[e, 0, 0], w * information[e, 0, 1], w * information[e, 0, 2]
        o10, o11, o12 = w * information[e, 1, 0], w * information[e, 1, 1], w * information[e, 1, 2]
        o20, o21, o22 = w * information[e, 2, 0], w * information[e, 2, 1], w * information[e, 2, 2]
        x00, x01, x02 = c * o00 - s * o10, c * o01 - s * o11, c * o02 - s * o12  # B^T O
        x10, x11, x12 = s * o00 + c * o10, s * o01 + c * o11, s * o02 + c * o12
        y0, y1, y2 = d0 * o00 + d1 * o10 - o20, d0 * o01 + d1 * o11 - o21, d0 * o02 + d1 * o12 - o22  # last of A^T O
        r0, r1, r2 = r[e, 0], r[e, 1], r[e, 2]
        g0, g1 = x00 * r0 + x01 * r1 + x02 * r2, x10 * r0 + x11 * r1 + x12 * r2
        gradient[i, 0] += g0
        gradient[i, 1] += g1
        gradient[i, 2] -= y0 * r0 + y1 * r1 + y2 * r2
        gradient[j, 0] -= g0
        gradient[j, 1] -= g1
        gradient[j, 2] -= o20 * r0 + o21 * r1 + o22 * r2
        h00, h01, h02 = x00 * c - x01 * s, x00 * s + x01 * c, x00 * d0 + x01 * d1 - x02  # B^T O B, and O A's last
        h10, h11, h12 = x10 * c - x11 * s, x10 * s + x11 * c, x10 * d0 + x11 * d1 - x12
        h20, h21, h22 = o20 * c - o21 * s, o20 * s + o21 * c, o20 * d0 + o21 * d1 - o22
        diagonal[j, 0, 0] += h00
        diagonal[j, 0, 1] += h01
        diagonal[j, 0, 2] += x02
        diagonal[j, 1, 0] += h10
        diagonal[j, 1, 1] += h11
        diagonal[j, 1, 2] += x12
        diagonal[j, 2, 0] += h20
        diagonal[j, 2, 1] += h21
        diagonal[j, 2, 2] += o22
        diagonal[i, 0, 0] += h00
        diagonal[i, 0, 1] += h01
        diagonal[i, 0, 2] -= h02
        diagonal[i, 1, 0] += h10
        diagonal[i, 1, 1] += h11
        diagonal[i, 1, 2] -= h12
        diagonal[i, 2, 0] += -y0 * c + y1 * s
        diagonal[i, 2, 1] += -y0 * s - y1 * c
        diagonal[i, 2, 2] += y0 * d0 + y1 * d1 - y2
        block = block_of_edge[e]
        if block < 0:
            continue
        if j > i:
            blocks[block, 0, 0] -= h00
            blocks[block, 0, 1] -= h01
            blocks[block, 0, 2] += h02
            blocks[block, 1, 0] -= h10
            blocks[block, 1, 1] -= h11
            blocks[block, 1, 2] += h12
            blocks[block, 2, 0] -= h20
            blocks[block, 2, 1] -= h21
            blocks[block, 2, 2] += h22
        else:
            blocks[block, 0, 0] -= h00
            blocks[block, 1, 0] -= h01
            blocks[block, 2, 0] += h02
            blocks[block, 0, 1] -= h10
            blocks[block, 1, 1] -= h11
            blocks[block, 2, 1] += h12
            blocks[block, 0, 2] -= h20
            blocks[block, 1, 2] -= h21
            blocks[block, 2, 2] += h22
    for pose in held:
        for row in range(3):
            for col in range(3):
                diagonal[pose, row, col] = 1.0 if row == col else 0.0
            gradient[pose, row] = 0.0
    return diagonal, blocks, gradient


@kernel
def damped(diagonal, damping):
    """Diagonal blocks (n, 3, 3) with Levenberg-Marquardt damping."""
    out = diagonal.copy()
    for i in range(len(out)):
        for k in range(3):
            out[i, k, k] = out[i, k, k] * (1 + damping) + 1e-9
    return out


@kernel
def moved_by(poses, delta, held):
    """Poses after a step, and the largest moves [m, rad]; fixed poses `held` (k,) stay bit-identical."""
    out = poses.copy()
    moved_m, moved_rad = 0.0, 0.0
    for i in range(len(poses)):
        out[i, 0] += delta[i, 0]
        out[i, 1] += delta[i, 1]
        out[i, 2] = wrapped(out[i, 2] + delta[i, 2])
        moved_m = max(moved_m, abs(delta[i, 0]), abs(delta[i, 1]))
        moved_rad = max(moved_rad, abs(wrapped(delta[i, 2])))
    for i in held:
        out[i] = poses[i]
    return out, moved_m, moved_rad


@kernel
def sparse_step(
    poses, edges, measured, information, weight, block_of_edge, held, order, start, node_of, block_of, target_start,
    target, block_count, damping,
):  # fmt: skip
    """See `NormalEquations._solve_step`; for patterns without a dense remainder."""
    diagonal, blocks, solution = linearise_relative(
        poses, edges, measured, information, weight, block_of_edge, block_count, held
    )
    diagonal = damped(diagonal, damping)
    lower = np.empty((len(node_of), 3, 3))
    is_sound = factorise(order, start, node_of, block_of, target_start, target, diagonal, blocks, lower, solution)
    if is_sound:
        substitute_back(order, start, node_of, diagonal, lower, solution)
    moved, moved_m, moved_rad = moved_by(poses, solution, held)
    return is_sound, moved, moved_m, moved_rad
