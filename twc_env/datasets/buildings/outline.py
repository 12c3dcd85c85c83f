"""Outlines: traced around a patch of cells, and simplified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel


def outer_ring(mask: Array) -> Array:
    """(k, 2) corners x, y [cells] around one 4-connected patch of cells (rows, columns), counter-clockwise, not closed.

    Holes are left out.
    """
    padded = np.ascontiguousarray(np.pad(mask, 1))
    row = int(np.argmax(padded.any(axis=1)))
    column = int(np.argmax(padded[row]))
    ring = np.empty((4 * int(mask.sum()) + 4, 2), np.int64)
    count = _walk(padded, row, column, ring)
    return ring[:count].astype(float) - 1.0


def sides_of(ring: Array) -> Array:
    """(k, 2, 2) ends of the sides of a ring (k, 2)."""
    return np.stack([ring, np.concatenate([ring[1:], ring[:1]])], axis=1)


def without_repeats(ring: Array) -> Array:
    """Corners of a closed ring (k, 2) without consecutive duplicates; a single corner if all are equal."""
    is_repeated = np.all(ring == np.concatenate([ring[-1:], ring[:-1]]), axis=1)
    return ring[:1] if is_repeated.all() else ring[~is_repeated]


def simplified_ring(ring: Array, tolerance_m: float) -> Array:
    """A closed ring (k, 2) with fewer corners, at most the tolerance from the dropped ones (Douglas-Peucker)."""
    ring = without_repeats(ring)
    if len(ring) < 4:
        return ring
    far = int(np.argmax(np.linalg.norm(ring - ring[0], axis=1)))
    opened = np.ascontiguousarray(np.concatenate([ring, ring[:1]]))
    keep = np.zeros(len(opened), np.bool_)
    keep[[0, far, -1]] = True
    _keep_corners(opened, 0, far, tolerance_m, keep)
    _keep_corners(opened, far, len(opened) - 1, tolerance_m, keep)
    return ring[keep[:-1]]


@kernel
def _keep_corners(points, begin, end, tolerance, keep):
    stack = [(begin, end)]
    while len(stack) > 0:
        i, j = stack.pop()
        ex, ey = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        length2 = max(ex * ex + ey * ey, 1e-18)
        worst, at = tolerance * tolerance, -1
        for k in range(i + 1, j):
            ax, ay = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
            t = min(max((ax * ex + ay * ey) / length2, 0.0), 1.0)
            gap2 = (ax - t * ex) ** 2 + (ay - t * ey) ** 2
            if gap2 > worst:
                worst, at = gap2, k
        if at >= 0:
            keep[at] = True
            stack.append((i, at))
            stack.append((at, j))


@kernel
def _walk(mask, row, column, ring):
    """Trace the edges with the patch on the left, from the lower left corner of its first cell; mask is padded."""
    x, y, dx, dy = column, row, 1, 0
    count = 0
    while count < ring.shape[0]:
        ring[count, 0], ring[count, 1] = x, y
        count += 1
        while True:
            x, y = x + dx, y + dy
            # The two cells ahead of the corner: on the left and on the right of the way.
            left = mask[y + (dx + dy - 1) // 2, x + (dx - dy - 1) // 2]
            right = mask[y + (dy - dx - 1) // 2, x + (dx + dy - 1) // 2]
            if not left:
                dx, dy = -dy, dx
                break
            if right:
                dx, dy = dy, -dx
                break
        if x == column and y == row:
            break
    return count
