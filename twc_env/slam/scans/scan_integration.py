"""Integrate scans into a log-odds grid: the compiled part of `OccupancyGrid`.

Free space is the visible polygon, rasterised by scan conversion: each polygon edge toggles a bit in every row that it
crosses, and all cells between pairs of bits are filled. Nothing is sorted, and each cell is visited once per scan. Then
the cells that returned a beam are raised. A cell is free below 0, wall above 0, unknown at 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, parts_of
from twc_env.records.messages import BLOCK_SHAPE
from twc_env.slam.scans.cell_kinds import note_kinds

LOG_ODDS_FREE = -4
LOG_ODDS_HIT = 10
LOG_ODDS_MIN = -60
LOG_ODDS_MAX = 80
FREE_MARGIN_CELLS = 0.5
"""Free space ends this far before the measured wall."""
WORD_CELLS, PART_CELLS = 64, 32
"""Cells of a row per 64-bit word, and how many of them are updated at once (SIMD)."""
_BITS = np.uint32(1) << np.arange(PART_CELLS, dtype=np.uint32)
FEW_ROWS = 2
"""Rows of an edge that are marked without a branch, whether or not it crosses them."""
BLOCK_ROWS, BLOCK_COLUMNS = BLOCK_SHAPE
BLOCK_CELLS = 32
"""Cells of a row whose kinds are updated at once: a few too many are faster than a remainder loop."""


@borrowing_kernel
def _lay_out(gx, gy, row_low, c, s, margin, directions, ranges, range_max, corners, cells):
    """End of the free space in each beam direction, in real rows and columns, and the cell that each beam hit.

    Separate from the rest so that it vectorises over beams: corners (2, beams + 1), the last repeated first; cells (2,
    beams): column and row, row -1 without a return.
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
    """First row in 0..last_row whose centre line each polygon edge crosses, and the end row: rows (2, edges).

    edges (2, edges): column at the first row as a real number, and its change per row.
    """
    for i in range(edges.shape[1]):
        px, py, qx, qy = corners[0, i], corners[1, i], corners[0, i + 1], corners[1, i + 1]
        low, high = min(py, qy), max(py, qy)
        first = max(np.ceil(low), 0.0)
        slope = (qx - px) / (qy - py)
        edges[0, i], edges[1, i] = px + (first - py) * slope, slope
        rows[0, i], rows[1, i] = np.int32(first), np.int32(min(np.ceil(high), last_row + 1.0))


@borrowing_kernel
def _column_of(x, low, high):
    """The smallest integer column >= x, clamped to low..high."""
    column = np.ceil(x)
    column = column if column > low else low
    return np.int32(column if column < high else high)


@borrowing_kernel
def _mark_crossings(edges, rows, first_column, end_column, marks):
    """Toggle the bit of the column at which an edge crosses the centre line of a row, for each edge and row.

    Bits count columns from the first one on, 64 per word of marks (words, rows); columns outside are clamped to the
    border. Most edges cross few rows, and the number is unpredictable: the first rows are marked without a branch.
    """
    low, high, one, last_row = float(first_column), float(end_column), np.uint64(1), np.uint64(marks.shape[1] - 1)
    for i in range(edges.shape[1]):
        x, slope, first, end = edges[0, i], edges[1, i], np.uint64(rows[0, i]), np.uint64(max(rows[0, i], rows[1, i]))
        for k in range(np.uint64(FEW_ROWS)):
            is_crossed, row = np.uint64(first + k < end), min(first + k, last_row)
            column = np.uint64(_column_of(x, low, high) - first_column)
            x += slope
            marks[column >> np.uint64(6), row] ^= is_crossed << (column & np.uint64(63))
        for further in range(first + np.uint64(FEW_ROWS), end):
            column = np.uint64(_column_of(x, low, high) - first_column)
            x += slope
            marks[column >> np.uint64(6), further] ^= one << (column & np.uint64(63))


@borrowing_kernel
def _fill_between(marks, words, rows, is_inside):
    """Cells inside the polygon: from each odd mark of a row up to the next one. Clears all marks.

    is_inside: bits as in marks (words, rows). Vectorised over rows.
    """
    for k in range(words):
        mark, inside = marks[k, :rows], is_inside[k, :rows]
        if k == 0:
            for row in range(rows):
                inside[row] = mark[row]
        else:
            before = is_inside[k - 1, :rows]
            for row in range(rows):  # the first bit continues the state at the end of the previous word
                inside[row] = mark[row] ^ (before[row] >> np.uint64(63))
        for row in range(rows):
            word = inside[row]
            word ^= word << np.uint64(1)
            word ^= word << np.uint64(2)
            word ^= word << np.uint64(4)
            word ^= word << np.uint64(8)
            word ^= word << np.uint64(16)
            inside[row] = word ^ (word << np.uint64(32))
    for k in range(words + 1):
        mark = marks[k, :rows]
        for row in range(rows):
            mark[row] = np.uint64(0)


@borrowing_kernel
def _lower(levels, start, word):
    """Lower the log-odds of the cells of a row whose bits are set, counted from cell `start`."""
    if start + WORD_CELLS > levels.shape[0]:
        for j in range(levels.shape[0] - start):
            if (word >> np.uint64(j)) & np.uint64(1):
                levels[start + j] = max(levels[start + j] + LOG_ODDS_FREE, LOG_ODDS_MIN)
        return
    for part in range(0, WORD_CELLS, PART_CELLS):
        block, bits = levels[start + part : start + part + PART_CELLS], np.uint32(word >> np.uint64(part))
        for j in range(PART_CELLS):
            lowered = np.int16(max(np.int16(block[j] + np.int16(LOG_ODDS_FREE)), np.int16(LOG_ODDS_MIN)))
            block[j] = lowered if np.uint32(bits & _BITS[j]) != np.uint32(0) else block[j]


@borrowing_kernel
def _find_news(levels, start, word, span):
    """Extend a span of columns by the blocks of a row in which lowering these cells makes one free or unknown.

    Mostly there is none: free cells stay free.
    """
    if start + WORD_CELLS > levels.shape[0]:
        span[0], span[1] = min(span[0], start), levels.shape[0] - 1
        return
    for part in range(0, WORD_CELLS, PART_CELLS):
        block, bits = levels[start + part : start + part + PART_CELLS], np.uint32(word >> np.uint64(part))
        lowest = np.uint16(2**16 - 1)  # of the lowered cells; negative values wrap to large ones
        for j in range(PART_CELLS):
            level = np.uint16(block[j]) if np.uint32(bits & _BITS[j]) != np.uint32(0) else np.uint16(2**16 - 1)
            lowest = min(lowest, level)
        if lowest <= np.uint16(-LOG_ODDS_FREE):
            span[0], span[1] = min(span[0], start + part), max(span[1], start + part + PART_CELLS - 1)


@borrowing_kernel
def look_through(
    shape, step, origin_x, origin_y, inverse_m, pose, directions, ranges, range_max, marks, is_inside, corners, edges,
    rows, cells,
):  # fmt: skip
    """Rasterise the free space of a scan on a grid of that shape, as a bit per cell: is_inside (words, rows).

    Returns the first row, the number of rows, the first column, which is a multiple of `step` if the width is, and the
    number of words. cells: as in `_lay_out`.
    """
    height, width = shape
    c, s = math.cos(pose[2]) * inverse_m, math.sin(pose[2]) * inverse_m
    gx, gy = (pose[0] - origin_x) * inverse_m - 0.5, (pose[1] - origin_y) * inverse_m - 0.5
    margin = FREE_MARGIN_CELLS / inverse_m
    reach = 0.0
    for i in range(ranges.shape[0]):
        reach = max(reach, min(abs(ranges[i]), range_max))
    reach *= inverse_m
    row_low = max(0, int(gy - reach) - 1)
    row_high = min(height - 1, int(gy + reach) + 2)
    end_column = min(width, int(gx + reach) + 3)
    first_column = max(0, int(gx - reach) - 1) // step * step
    words = (end_column - first_column) // WORD_CELLS + 1
    first_column = max(0, min(first_column, width - words * WORD_CELLS))
    row_count = row_high + 1 - row_low
    _lay_out(gx, gy, row_low, c, s, margin, directions, ranges, range_max, corners, cells)
    _cut(corners, float(row_high - row_low), edges, rows)
    _mark_crossings(edges, rows, first_column, end_column, marks)
    _fill_between(marks, words, row_count, is_inside)
    return row_low, row_count, first_column, words


@borrowing_kernel
def _integrate_scan(
    log_odds, origin_x, origin_y, inverse_m, pose, directions, ranges, range_max, marks, is_inside, spans, corners,
    edges, rows, cells,
):  # fmt: skip
    """Lower the free cells of a scan and raise the cells that it hit.

    Returns the first and last row that it may change; spans (rows, 2), unless empty, gets per row the first and last
    column between which cells became free, unknown or wall.
    """
    height, width = log_odds.shape
    beams, has_spans = ranges.shape[0], spans.shape[0] > 0
    row_low, row_count, first_column, words = look_through(
        (height, width), 1, origin_x, origin_y, inverse_m, pose, directions, ranges, range_max, marks, is_inside,
        corners, edges, rows, cells,
    )  # fmt: skip
    row_high = row_low + row_count - 1
    for row in range(row_count):
        if has_spans:
            spans[row, 0], spans[row, 1] = width, -1
        for k in range(words):
            word, start = is_inside[k, row], first_column + k * WORD_CELLS
            if word == np.uint64(0):
                continue
            if has_spans:
                _find_news(log_odds[row_low + row], start, word, spans[row])
            _lower(log_odds[row_low + row], start, word)
    last_row = last_column = -1
    for i in range(beams):
        column, row = cells[0, i], cells[1, i]
        if row < 0 or column < 0 or row >= height or column >= width:
            continue
        raised = LOG_ODDS_HIT if (row != last_row) | (column != last_column) else 0  # unpredictable: no branch
        last_row, last_column, before = row, column, log_odds[row, column]
        log_odds[row, column] = min(before + raised, LOG_ODDS_MAX)
        if has_spans and -LOG_ODDS_HIT <= before <= 0:  # otherwise the kind does not change
            at = min(max(row - row_low, 0), row_high - row_low)
            spans[at, 0], spans[at, 1] = min(spans[at, 0], column), max(spans[at, 1], column)
    return row_low, row_high


@borrowing_kernel
def _note_spans(log_odds, row_low, row_high, spans, kinds):
    """`note_kinds` of the squares that contain a cell of the spans."""
    for row in range(row_low - 1, row_high + 1):
        above, here = min(row + 1, row_high) - row_low, max(row, row_low) - row_low
        first, last = min(spans[here, 0], spans[above, 0]), max(spans[here, 1], spans[above, 1])
        if first <= last:
            blocks = (last + 1 - first) // BLOCK_CELLS + 1
            note_kinds(log_odds, row, first - 1, row + 1, first - 1 + blocks * BLOCK_CELLS, kinds)


@borrowing_kernel
def _note_touched(row, first_column, last_column, number, touched):
    """Write the number of a scan to the blocks that contain these cells of a row."""
    for block in range(first_column // BLOCK_COLUMNS, last_column // BLOCK_COLUMNS + 1):
        touched[row // BLOCK_ROWS, block] = number


@borrowing_kernel
def _integrate_inside(
    log_odds, kinds, touched, number, bounds, reached, inverse_m, poses, directions, scans, range_max, room
):
    """Integrate scans that stay within the box `reached`, in a grid with these bounds."""
    marks, is_inside, spans, corners, edges, rows, cells = room
    noted = spans[: spans.shape[0] if poses.shape[0] == 1 else 0]
    for k in range(poses.shape[0]):
        row_low, row_high = _integrate_scan(
            log_odds, bounds[0], bounds[1], inverse_m, poses[k], directions, scans[k], range_max, marks, is_inside,
            noted, corners, edges, rows, cells,
        )  # fmt: skip
        if poses.shape[0] == 1:
            _note_spans(log_odds, row_low, row_high, spans, kinds)
            for row in range(row_low, row_high + 1):
                _note_touched(row, spans[row - row_low, 0], spans[row - row_low, 1], number, touched)
    if poses.shape[0] > 1:  # the scans overlap, so kinds are updated once at the end
        bottom, left = int((reached[1] - bounds[1]) * inverse_m) - 2, int((reached[0] - bounds[0]) * inverse_m) - 2
        top, right = int((reached[3] - bounds[1]) * inverse_m) + 3, int((reached[2] - bounds[0]) * inverse_m) + 3
        note_kinds(log_odds, bottom, left, top, right, kinds)
        for row in range(max(bottom, 0), min(top, log_odds.shape[0])):
            _note_touched(row, max(left, 0), min(right, log_odds.shape[1]) - 1, number, touched)


@borrowing_kernel
def integrate_many(grid, poses, scans):
    """Integrate scans that lie inside the first box of `boxes`, and extend the second by the area they can change.

    Writes that area to `reached` (4,); returns False, without integrating, if it is not inside or a pose is not finite.
    """
    log_odds, kinds, touched, numbers, boxes, inverse_m, directions, range_max, reached, room = parts_of(grid)
    low_x, low_y, high_x, high_y, reach = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for k in range(poses.shape[0]):
        if not abs(poses[k, 0]) + abs(poses[k, 1]) + abs(poses[k, 2]) < np.inf:
            return False
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
    """Work arrays of `_integrate_scan`: marks, inside bits, spans, corners, edges, their rows, and cells.

    Kept between calls, since allocation is slow. Scans reach over as many columns as rows.
    """
    words = rows // WORD_CELLS + 2  # one more if the first column is not a multiple of the word size
    return (
        np.zeros((words + 1, rows), np.uint64),
        np.zeros((words, rows), np.uint64),
        np.zeros((rows, 2), np.int32),
        np.zeros((2, beams + 1)),
        np.zeros((2, beams)),
        np.zeros((2, beams), np.int32),
        np.zeros((2, beams), np.int32),
    )
