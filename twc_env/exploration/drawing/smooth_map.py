"""An estimated map without steps: walls as strokes along their local direction, known space with a smooth edge.

Cells of a map that is turned against the picture look like a chain of diamonds. So the centre of every wall cell is
moved onto the line that fits the wall cells around it (principal axes, weighted by a Gaussian; a narrower one where the
wide one sees no line, as near corners), and strokes join the centres of neighbouring wall cells. A stroke is as wide as
the cells are spread across the line: a band of width w has the variance w^2 / 12. A single cell is a disc. Nothing but
the estimate enters, and no centre moves by more than `SHIFT_MAX` cells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

WINDOWS = (1.7, 4), (0.9, 2)
"""Standard deviation of the weights, and half the width of the window, in cells: wide, and narrow."""
LINE_MAX = 0.16
"""Largest ratio of the variances across and along a wall."""
SHIFT_MAX = 1.0
HALF_WIDTH_CELLS = 0.5, 1.5
"""Least and largest half width of a stroke."""
BORDER = 2
"""Empty cells around the field of known space, so that it is closed."""
KNOWN_LEVEL = 0.5


def wall_strokes(log_odds: Array) -> Array:
    """(strokes, 5) float64: x1, y1, x2, y2 and half width of each stroke, in cells from the map's corner; a disc has
    equal ends. log_odds: (h, w), wall above 0."""
    is_wall = np.ascontiguousarray(log_odds) > 0
    centres = np.zeros((*is_wall.shape, 3))
    _fit(is_wall, np.array(WINDOWS), centres)
    return _joined(is_wall, centres)


def known_field(log_odds: Array) -> Array:
    """(h + 4, w + 4) float32: the known cells convolved with (1, 4, 1) / 6 along both axes, the samples of a cubic
    B-spline; interpolated linearly, known space is where it exceeds `KNOWN_LEVEL`."""
    padded = np.pad((np.asarray(log_odds) != 0).astype(np.float32), BORDER)
    for axis in (0, 1):
        padded = (4.0 * padded + np.roll(padded, 1, axis) + np.roll(padded, -1, axis)) / np.float32(6.0)
    return padded


@kernel
def _fit(is_wall, windows, centres):
    """Write x, y and half width [cells] of every wall cell to centres (h, w, 3)."""
    rows, columns = is_wall.shape
    least, largest = HALF_WIDTH_CELLS
    for row in range(rows):
        for column in range(columns):
            if not is_wall[row, column]:
                continue
            x, y, half_width = column + 0.5, row + 0.5, least
            for window in range(windows.shape[0]):
                spread, reach = windows[window, 0], int(windows[window, 1])
                total = sx = sy = sxx = sxy = syy = 0.0
                for m in range(max(0, row - reach), min(rows, row + reach + 1)):
                    for n in range(max(0, column - reach), min(columns, column + reach + 1)):
                        if is_wall[m, n]:
                            right, up = float(n - column), float(m - row)
                            weight = math.exp(-0.5 * (right * right + up * up) / spread**2)
                            total += weight
                            sx, sy = sx + weight * right, sy + weight * up
                            sxx, sxy = sxx + weight * right * right, sxy + weight * right * up
                            syy += weight * up * up
                right, up = sx / total, sy / total
                a, b, c = sxx / total - right * right, sxy / total - right * up, syy / total - up * up
                middle, half = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
                along, across = middle + half, max(middle - half, 0.0)
                angle = 0.5 * math.atan2(2.0 * b, a - c)
                shift = -math.sin(angle) * right + math.cos(angle) * up
                if along > 1e-9 and across <= LINE_MAX * along and abs(shift) <= SHIFT_MAX:
                    x, y = x - math.sin(angle) * shift, y + math.cos(angle) * shift
                    half_width = min(max(0.5 * math.sqrt(12.0 * across), least), largest)
                    break
            centres[row, column, 0], centres[row, column, 1], centres[row, column, 2] = x, y, half_width


@kernel
def _joined(is_wall, centres):
    """A disc for each wall cell and a stroke to each of its neighbours: (strokes, 5)."""
    rows, columns = is_wall.shape
    count = 0
    for row in range(rows):
        for column in range(columns):
            count += is_wall[row, column]
    strokes = np.empty((5 * count, 5))
    k = 0
    for row in range(rows):
        for column in range(columns):
            if not is_wall[row, column]:
                continue
            x, y, half_width = centres[row, column, 0], centres[row, column, 1], centres[row, column, 2]
            strokes[k, 0], strokes[k, 1], strokes[k, 2], strokes[k, 3], strokes[k, 4] = x, y, x, y, half_width
            k += 1
            for side in range(4):
                m, n = (row, column + 1) if side == 0 else (row + 1, column + side - 2)
                if m >= rows or n < 0 or n >= columns or not is_wall[m, n]:
                    continue
                strokes[k, 0], strokes[k, 1] = x, y
                strokes[k, 2], strokes[k, 3] = centres[m, n, 0], centres[m, n, 1]
                strokes[k, 4] = 0.5 * (half_width + centres[m, n, 2])
                k += 1
    return strokes[:k]
