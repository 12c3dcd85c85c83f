"""An estimated map without steps: walls as strokes along their local direction, known space with a smooth edge.

Cells of a map that is turned against the picture look like a chain of diamonds. So the centre of every wall cell is
moved onto the line that fits the wall cells around it (principal axes, weighted by a Gaussian). The line is sought
first in all directions (in another window where the first one sees none, as near corners), then among the cells along
it, farther, so that a straight wall is drawn straight and equally thick. Strokes join the centres of neighbouring wall
cells. They are as wide as the cells are spread across the line: a band of width w has the variance w^2 / 12.

Few beams hit a wall that is far away, or seen at a flat angle, and leave wall cells with gaps. A stroke joins the ends
of such a gap if both lie on one line, and it is at most `GAP_MAX` cells long and known as free in at most half, or
`GAP_FREE_MAX` cells (a door has seven or more). A cell that belongs to no line and has no neighbour is a small square.
Nothing but the estimate enters, and no centre moves by more than `SHIFT_MAX` cells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

WINDOWS = (1.7, 4), (0.9, 2), (3.0, 6)
"""Standard deviation of the weights, and half the width of the window, in cells: wide, narrow, and for cells far apart.
"""
ALONG = 4.0, 9
"""The same along a line that was found, in which cells count that lie at most"""
ACROSS_MAX = 1.6
"""cells beside it."""
LINE_MAX = 0.16
"""Largest ratio of the variances across and along a wall."""
SHIFT_MAX = 1.0
HALF_WIDTH_CELLS = 0.5, 1.5
"""Least and largest half width of a stroke."""
GAP_MAX, GAP_FREE_MAX = 5.0, 3.5
"""Longest distances of the centres of cells that a stroke joins across a gap: if at most half of it is known as free,
and anyway."""
ASIDE_MAX = 0.26
"""Largest sine of the angle between such a stroke and the lines at its ends."""
SQUARE = 0.2, 0.3
"""Single cells are two strokes: half their length and distance, and half their width [cells]."""
EVEN_REACH = 4
"""The half width of a cell is the least of those up to so many cells away on the same line."""
STROKES_MAX = 6
"""Of a cell: to four neighbours, and over two gaps."""
NUMBERS = {
    "windows": WINDOWS, "along": ALONG, "across_max": ACROSS_MAX, "line_max": LINE_MAX, "shift_max": SHIFT_MAX,
    "least": HALF_WIDTH_CELLS[0], "largest": HALF_WIDTH_CELLS[1], "gap_max": GAP_MAX, "gap_free_max": GAP_FREE_MAX,
    "aside_max": ASIDE_MAX, "even_reach": EVEN_REACH, "square": SQUARE,
}  # fmt: skip
"""For the script of the replay page, which draws walls in the same way."""
BORDER = 2
"""Empty cells around the field of known space, so that it is closed."""
KNOWN_LEVEL = 0.5


def wall_strokes(log_odds: Array) -> Array:
    """(strokes, 5) float64: x1, y1, x2, y2 and half width of each stroke, in cells from the map's corner; ends are
    round, and may be equal. log_odds: (h, w), wall above 0, free below."""
    kinds = np.sign(log_odds).astype(np.int8)
    lines = np.zeros((*kinds.shape, 5))
    _fit(kinds, lines)
    _make_even(kinds, lines, lines[..., 2].copy())
    strokes = np.empty((STROKES_MAX * np.count_nonzero(kinds > 0), 5))
    return strokes[: _join(kinds, lines, strokes)]


def known_field(log_odds: Array) -> Array:
    """(h + 4, w + 4) float32: the known cells convolved with (1, 4, 1) / 6 along both axes, the samples of a cubic
    B-spline; interpolated linearly, known space is where it exceeds `KNOWN_LEVEL`."""
    padded = np.pad((np.asarray(log_odds) != 0).astype(np.float32), BORDER)
    for axis in (0, 1):
        padded = (4.0 * padded + np.roll(padded, 1, axis) + np.roll(padded, -1, axis)) / np.float32(6.0)
    return padded


@kernel
def _line_at(kinds, row, column, spread, reach, direction, aside):
    """The line that fits the wall cells around a cell: its direction (cos, sin), its distance from the cell, to the
    left, and the standard deviation of the cells across it, negative without a line.

    direction: (cos, sin) of a line at the distance `aside`, beside which cells count up to `ACROSS_MAX`; (0, 0): all
    cells count.
    """
    rows, columns = kinds.shape
    total = sx = sy = sxx = sxy = syy = 0.0
    is_known = direction[0] != 0.0 or direction[1] != 0.0
    for m in range(max(0, row - reach), min(rows, row + reach + 1)):
        for n in range(max(0, column - reach), min(columns, column + reach + 1)):
            if kinds[m, n] <= 0:
                continue
            x, y = float(n - column), float(m - row)
            if is_known and abs(direction[0] * y - direction[1] * x - aside) > ACROSS_MAX:
                continue
            weight = math.exp(-0.5 * (x * x + y * y) / spread**2)
            total += weight
            sx, sy = sx + weight * x, sy + weight * y
            sxx, sxy, syy = sxx + weight * x * x, sxy + weight * x * y, syy + weight * y * y
    x, y = sx / total, sy / total
    a, b, c = sxx / total - x * x, sxy / total - x * y, syy / total - y * y
    middle, half = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    along, across = middle + half, max(middle - half, 0.0)
    angle = 0.5 * math.atan2(2.0 * b, a - c)
    cosine, sine = math.cos(angle), math.sin(angle)
    shift = cosine * y - sine * x
    is_line = along > 1e-9 and across <= LINE_MAX * along and abs(shift) <= SHIFT_MAX
    return cosine, sine, shift, math.sqrt(across) if is_line else -1.0


@kernel
def _fit(kinds, lines):
    """Write x, y, half width, and cosine and sine of the direction of every wall cell to lines (h, w, 5); both are 0
    where there is no line."""
    least, largest = HALF_WIDTH_CELLS
    for row in range(kinds.shape[0]):
        for column in range(kinds.shape[1]):
            if kinds[row, column] <= 0:
                continue
            x, y, half_width, cosine, sine = column + 0.5, row + 0.5, least, 0.0, 0.0
            for spread, reach in WINDOWS:
                found = _line_at(kinds, row, column, spread, reach, (0.0, 0.0), 0.0)
                if found[3] < 0.0:
                    continue
                for _ in range(2):
                    farther = _line_at(kinds, row, column, ALONG[0], ALONG[1], (found[0], found[1]), found[2])
                    if farther[3] < 0.0:
                        break
                    found = farther
                cosine, sine, shift, deviation = found
                x, y = x - sine * shift, y + cosine * shift
                half_width = min(max(0.5 * math.sqrt(12.0) * deviation, least), largest)
                break
            lines[row, column, 0], lines[row, column, 1], lines[row, column, 2] = x, y, half_width
            lines[row, column, 3], lines[row, column, 4] = cosine, sine


@kernel
def _make_even(kinds, lines, half_widths):
    """Give every wall cell the least of the half widths (h, w) of the cells near it on its line: at corners the cells
    of other walls add to the spread."""
    rows, columns = kinds.shape
    for row in range(rows):
        for column in range(columns):
            if kinds[row, column] <= 0 or lines[row, column, 2] == HALF_WIDTH_CELLS[0]:
                continue
            x, y, cosine, sine = (
                lines[row, column, 0],
                lines[row, column, 1],
                lines[row, column, 3],
                lines[row, column, 4],
            )
            for m in range(max(0, row - EVEN_REACH), min(rows, row + EVEN_REACH + 1)):
                for n in range(max(0, column - EVEN_REACH), min(columns, column + EVEN_REACH + 1)):
                    aside = cosine * (lines[m, n, 1] - y) - sine * (lines[m, n, 0] - x)
                    turn = cosine * lines[m, n, 4] - sine * lines[m, n, 3]
                    has_line = lines[m, n, 3] != 0.0 or lines[m, n, 4] != 0.0
                    if kinds[m, n] > 0 and has_line and abs(turn) <= ASIDE_MAX and abs(aside) <= ASIDE_MAX * EVEN_REACH:
                        lines[row, column, 2] = min(lines[row, column, 2], half_widths[m, n])


@kernel
def _join(kinds, lines, strokes):
    """Write strokes (k, 5) from each wall cell to each of its neighbours, and over gaps; single cells as squares.
    Returns their number."""
    rows, columns = kinds.shape
    k = 0
    for row in range(rows):
        for column in range(columns):
            if kinds[row, column] <= 0:
                continue
            is_single = True
            for side in range(8):
                m, n = row + (side + side // 4) // 3 - 1, column + (side + side // 4) % 3 - 1
                if 0 <= m < rows and 0 <= n < columns and kinds[m, n] > 0:
                    is_single = False
                    if side >= 4:  # the other four begin at the neighbours
                        k = _add_stroke(lines, row, column, m, n, strokes, k)
            for way in (-1.0, 1.0):
                m, n = _beyond_gap(kinds, lines, row, column, way)
                if m >= 0:
                    is_single = False
                    k = _add_stroke(lines, row, column, m, n, strokes, k)
            if is_single:
                for aside in (-SQUARE[0], SQUARE[0]):
                    strokes[k, 0], strokes[k, 1] = column + 0.5 - SQUARE[0], row + 0.5 + aside
                    strokes[k, 2], strokes[k, 3] = column + 0.5 + SQUARE[0], row + 0.5 + aside
                    strokes[k, 4] = SQUARE[1]
                    k += 1
    return k


@kernel
def _add_stroke(lines, row, column, m, n, strokes, k):
    """Write a stroke between two wall cells; returns the number of strokes."""
    strokes[k, 0], strokes[k, 1] = lines[row, column, 0], lines[row, column, 1]
    strokes[k, 2], strokes[k, 3] = lines[m, n, 0], lines[m, n, 1]
    strokes[k, 4] = 0.5 * (lines[row, column, 2] + lines[m, n, 2])
    return k + 1


@kernel
def _beyond_gap(kinds, lines, row, column, way):
    """Row and column of the nearest wall cell beyond a gap, along the line of a cell or, with way -1, against it; (-1,
    -1) if there is none."""
    rows, columns = kinds.shape
    cosine, sine, reach = way * lines[row, column, 3], way * lines[row, column, 4], int(GAP_MAX) + 1
    best_m, best_n, nearest = -1, -1, GAP_MAX
    if cosine == 0.0 and sine == 0.0:
        return best_m, best_n
    for m in range(max(0, row - reach), min(rows, row + reach + 1)):
        for n in range(max(0, column - reach), min(columns, column + reach + 1)):
            if kinds[m, n] <= 0 or (m == row and n == column):
                continue
            if max(abs(m - row), abs(n - column)) == 1:
                if cosine * (n - column) + sine * (m - row) > 0.5:
                    return -1, -1  # the wall goes on
                continue
            x, y = lines[m, n, 0] - lines[row, column, 0], lines[m, n, 1] - lines[row, column, 1]
            away = math.hypot(x, y)
            if away > nearest or cosine * x + sine * y <= 0.0 or abs(cosine * y - sine * x) > ASIDE_MAX * away:
                continue
            if lines[m, n, 3] == 0.0 and lines[m, n, 4] == 0.0:
                continue
            if abs(lines[m, n, 3] * y - lines[m, n, 4] * x) > ASIDE_MAX * away:
                continue
            best_m, best_n, nearest = m, n, away
    if nearest > GAP_FREE_MAX and best_m >= 0 and _free_share(kinds, lines, row, column, best_m, best_n) > 0.5:
        return -1, -1
    return best_m, best_n


@kernel
def _free_share(kinds, lines, row, column, m, n):
    """Share of known free cells on the way between two wall cells."""
    free, count = 0, 2 * int(GAP_MAX)
    for k in range(count):
        share = (k + 0.5) / count
        x = lines[row, column, 0] + share * (lines[m, n, 0] - lines[row, column, 0])
        y = lines[row, column, 1] + share * (lines[m, n, 1] - lines[row, column, 1])
        free += kinds[int(y), int(x)] < 0
    return free / count
