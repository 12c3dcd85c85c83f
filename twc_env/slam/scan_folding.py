"""Fold scans into log-odds cells: the compiled part of `OccupancyGrid`.

Free space is the visible polygon, filled row by row so that each cell is visited once per scan; the cells that returned
a beam are then raised. A cell is free below 0, wall above 0, unknown at 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import borrowing_kernel, parts_of
from twc_env.messages import BLOCK_SHAPE
from twc_env.slam.cell_kinds import note_kinds

Array = NDArray

LOG_ODDS_FREE = -4
LOG_ODDS_HIT = 10
LOG_ODDS_MIN = -60
LOG_ODDS_MAX = 80
FREE_MARGIN_CELLS = 0.5
"""Free space ends this far before the measured wall."""
RUN_CELLS = 32
"""Cells of a row that are lowered at once."""
_PLACES = np.arange(RUN_CELLS, dtype=np.int16)
BLOCK_ROWS, BLOCK_COLUMNS = BLOCK_SHAPE
BLOCK_CELLS = 32
"""What stands in a row is noted anew for so many cells at once: a few too many are quicker than a remainder."""


@borrowing_kernel
def _lay_out(gx, gy, row_low, c, s, margin, directions, ranges, range_max, corners, cells):
    """Where the free space ends in each direction, in rows and columns as reals, and the cell that each beam met.

    Apart from what follows, for many beams at once: corners (2, beams + 1), of which the last comes first too; cells
    (2, beams): column and row, which is -1 where the beam met nothing.
    """
    beams = ranges.shape[0]
    for i in range(beams):
        r = max(min(abs(ranges[i]), range_max) - margin, 0.0)
        dx, dy = r * directions[i, 0], r * directions[i, 1]
        corners[0, i + 1], corners[1, i + 1] = gx + c * dx - s * dy, gy - row_low + s * dx + c * dy
    corners[0, 0], corners[1, 0] = corners[0, beams], corners[1, beams]
    for i in range(beams):
        dx, dy = ranges[i] * directions[i, 0], ranges[i] * directions[i, 1]
        is_met = (ranges[i] >= 0.0) & (ranges[i] < range_max)
        cells[0, i] = np.int32(np.floor(gx + 0.5 + c * dx - s * dy))
        cells[1, i] = np.int32(np.floor(gy + 0.5 + s * dx + c * dy)) if is_met else np.int32(-1)


@borrowing_kernel
def _cut(corners, last_row, edges, rows):
    """First row 0..last_row whose centre line each edge between corners crosses and the end of these: rows (2, edges).

    edges (2, edges): the column at the first of them as a real, and how it changes from row to row.
    """
    for i in range(edges.shape[1]):
        px, py, qx, qy = corners[0, i], corners[1, i], corners[0, i + 1], corners[1, i + 1]
        low, high = min(py, qy), max(py, qy)
        first = max(np.ceil(low), 0.0)
        slope = (qx - px) / (qy - py)
        edges[0, i], edges[1, i] = px + (first - py) * slope, slope
        rows[0, i], rows[1, i] = np.int32(first), np.int32(min(np.ceil(high), last_row + 1.0))


@borrowing_kernel
def _fill_crossings(edges, rows, width, crossings, counts):
    """Note where the edges cross the centre lines of rows, sorted by column 0..width.

    crossings (edges, rows): an edge crosses each row once at most, and most rows are crossed by few.
    """
    one = np.uint64(1)
    for i in range(edges.shape[1]):
        x, slope = edges[0, i], edges[1, i]
        for row in range(np.uint64(rows[0, i]), np.uint64(max(rows[0, i], rows[1, i]))):
            column = np.int32(min(max(np.ceil(x), 0.0), width))
            x += slope
            k = np.uint64(counts[row])
            counts[row] = k + one
            while k > np.uint64(0) and crossings[k - one, row] > column:
                crossings[k, row] = crossings[k - one, row]
                k -= one
            crossings[k, row] = column


@borrowing_kernel
def _lower(levels, first, last):
    """Make the cells first..last - 1 of a row freer, whole blocks at once; in 16 bits throughout, twice as fast.

    A remainder of a block costs as much as many blocks, and most runs are shorter than two.
    """
    end = levels.shape[0] - RUN_CELLS
    if end < 0:
        for j in range(first, last):
            levels[j] = max(np.int16(levels[j] + LOG_ODDS_FREE), np.int16(LOG_ODDS_MIN))
        return
    at = first
    while at < last:
        start = min(at, end)
        low, high = np.int16(at - start), np.int16(min(last - start, RUN_CELLS))
        block = levels[start : start + RUN_CELLS]
        for j in range(RUN_CELLS):
            inside = (_PLACES[j] >= low) & (_PLACES[j] < high)
            block[j] = max(np.int16(block[j] + np.int16(LOG_ODDS_FREE * inside)), np.int16(LOG_ODDS_MIN))
        at = start + RUN_CELLS


@borrowing_kernel
def _find_news(levels, first, last, span):
    """Widen a span of columns by the blocks of a row in which lowering cells first..last - 1 makes one free or unknown.

    In most there is none: what was seen through before is seen through again.
    """
    end = levels.shape[0] - RUN_CELLS
    if end < 0:
        span[0], span[1] = 0, levels.shape[0] - 1
        return
    at = first
    while at < last:
        start = min(at, end)
        low, high = np.int16(at - start), np.int16(min(last - start, RUN_CELLS))
        block, is_new = levels[start : start + RUN_CELLS], False
        for j in range(RUN_CELLS):
            inside = (_PLACES[j] >= low) & (_PLACES[j] < high)
            is_new |= inside & (block[j] >= np.int16(0)) & (block[j] <= np.int16(-LOG_ODDS_FREE))
        if is_new:
            span[0], span[1] = min(span[0], at), max(span[1], start + high - 1)
        at = start + RUN_CELLS


@borrowing_kernel
def _integrate_scan(
    log_odds, origin_x, origin_y, inverse_m, pose, directions, ranges, range_max, crossings, counts, spans, corners,
    edges, rows, cells,
):  # fmt: skip
    """Lower what the scan saw through and raise what it met.

    Gives the first and last row that it can touch; spans (rows, 2) gets, where it has rows, the first and last column
    in each between which some cell has become free, unknown or wall.
    """
    height, width = log_odds.shape
    beams, has_spans = ranges.shape[0], spans.shape[0] > 0
    c, s = math.cos(pose[2]) * inverse_m, math.sin(pose[2]) * inverse_m
    gx, gy = (pose[0] - origin_x) * inverse_m - 0.5, (pose[1] - origin_y) * inverse_m - 0.5
    margin = FREE_MARGIN_CELLS / inverse_m
    reach = 0.0
    for i in range(beams):
        reach = max(reach, min(abs(ranges[i]), range_max))
    reach *= inverse_m
    row_low = max(0, int(gy - reach) - 1)
    row_high = min(height - 1, int(gy + reach) + 2)
    for row in range(row_low, row_high + 1):
        counts[row - row_low] = 0
    _lay_out(gx, gy, row_low, c, s, margin, directions, ranges, range_max, corners, cells)
    _cut(corners, float(row_high - row_low), edges, rows)
    _fill_crossings(edges, rows, float(width), crossings, counts)
    for row in range(row_low, row_high + 1):
        ends = counts[row - row_low] // 2 * 2
        if has_spans:
            spans[row - row_low, 0], spans[row - row_low, 1] = width, -1
        for p in range(ends // 2):
            first, last = crossings[2 * p, row - row_low], crossings[2 * p + 1, row - row_low]
            if first < last:
                if has_spans:
                    _find_news(log_odds[row], first, last, spans[row - row_low])
                _lower(log_odds[row], first, last)
    last_row = last_column = -1
    for i in range(beams):
        column, row = cells[0, i], cells[1, i]
        if row < 0 or column < 0 or row >= height or column >= width:
            continue
        raised = LOG_ODDS_HIT if (row != last_row) | (column != last_column) else 0  # hard to foresee: no branch
        last_row, last_column, before = row, column, log_odds[row, column]
        log_odds[row, column] = min(before + raised, LOG_ODDS_MAX)
        if has_spans and -LOG_ODDS_HIT <= before <= 0:  # else it stays free, or a wall
            at = min(max(row - row_low, 0), row_high - row_low)
            spans[at, 0], spans[at, 1] = min(spans[at, 0], column), max(spans[at, 1], column)
    return row_low, row_high


@borrowing_kernel
def _note_spans(log_odds, row_low, row_high, spans, kinds):
    """`note_kinds` of the squares that hold a cell of the spans."""
    for row in range(row_low - 1, row_high + 1):
        above, here = min(row + 1, row_high) - row_low, max(row, row_low) - row_low
        first, last = min(spans[here, 0], spans[above, 0]), max(spans[here, 1], spans[above, 1])
        if first <= last:
            blocks = (last + 1 - first) // BLOCK_CELLS + 1
            note_kinds(log_odds, row, first - 1, row + 1, first - 1 + blocks * BLOCK_CELLS, kinds)


@borrowing_kernel
def _note_touched(row, first_column, last_column, number, touched):
    """Write the number of a scan to the blocks in which cells of a row are."""
    for block in range(first_column // BLOCK_COLUMNS, last_column // BLOCK_COLUMNS + 1):
        touched[row // BLOCK_ROWS, block] = number


@borrowing_kernel
def _integrate_inside(
    log_odds, kinds, touched, number, bounds, reached, inverse_m, poses, directions, scans, range_max, room
):
    """Fold in scans that touch no more than the box `reached`, in a grid with these bounds."""
    crossings, counts, spans, corners, edges, rows, cells = room
    noted = spans[: spans.shape[0] if poses.shape[0] == 1 else 0]
    for k in range(poses.shape[0]):
        row_low, row_high = _integrate_scan(
            log_odds, bounds[0], bounds[1], inverse_m, poses[k], directions, scans[k], range_max, crossings, counts,
            noted, corners, edges, rows, cells,
        )  # fmt: skip
        if poses.shape[0] == 1:
            _note_spans(log_odds, row_low, row_high, spans, kinds)
            for row in range(row_low, row_high + 1):
                _note_touched(row, spans[row - row_low, 0], spans[row - row_low, 1], number, touched)
    if poses.shape[0] > 1:  # they touch the same cells again and again
        bottom, left = int((reached[1] - bounds[1]) * inverse_m) - 2, int((reached[0] - bounds[0]) * inverse_m) - 2
        top, right = int((reached[3] - bounds[1]) * inverse_m) + 3, int((reached[2] - bounds[0]) * inverse_m) + 3
        note_kinds(log_odds, bottom, left, top, right, kinds)
        for row in range(max(bottom, 0), min(top, log_odds.shape[0])):
            _note_touched(row, max(left, 0), min(right, log_odds.shape[1]) - 1, number, touched)


@borrowing_kernel
def integrate_many(grid, poses, scans):
    """Fold in scans that lie inside the first box, and widen the second by what these can touch.

    Writes that box to `reached` (4,); whether it lay inside.
    """
    log_odds, kinds, touched, numbers, boxes, inverse_m, directions, range_max, reached, room = parts_of(grid)
    low_x, low_y, high_x, high_y, reach = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for k in range(poses.shape[0]):
        low_x, high_x = min(low_x, poses[k, 0]), max(high_x, poses[k, 0])
        low_y, high_y = min(low_y, poses[k, 1]), max(high_y, poses[k, 1])
        for i in range(scans.shape[1]):
            reach = max(reach, abs(scans[k, i]))
    reach = min(reach, range_max)
    reached[0], reached[1], reached[2], reached[3] = low_x - reach, low_y - reach, high_x + reach, high_y + reach
    bounds = boxes[0]
    if reached[0] < bounds[0] or reached[1] < bounds[1] or reached[2] > bounds[2] or reached[3] > bounds[3]:
        return False
    for side in range(2):
        boxes[1, side] = min(boxes[1, side], reached[side])
        boxes[1, 2 + side] = max(boxes[1, 2 + side], reached[2 + side])
    numbers[0] += 1
    _integrate_inside(
        log_odds, kinds, touched, numbers[0], bounds, reached, inverse_m, poses, directions, scans, range_max, room
    )
    return True


def folding_room(beams: int, rows: int) -> tuple[Array, ...]:
    """Crossings, counts, spans, corners, edges, their rows, and cells of `_integrate_scan`: kept, as new arrays of this
    size take long to get."""
    return (
        np.zeros((beams + 2, rows), np.int32),
        np.zeros(rows, np.int32),
        np.zeros((rows, 2), np.int32),
        np.zeros((2, beams + 1)),
        np.zeros((2, beams)),
        np.zeros((2, beams), np.int32),
        np.zeros((2, beams), np.int32),
    )
