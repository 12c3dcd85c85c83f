"""Sparse Cholesky factorisation of symmetric matrices of 3 x 3 blocks, one block row per pose.

The symbolic part (minimum-degree elimination order and fill-in) is computed once per graph; each numeric factorisation
then runs through flat arrays. When the remaining graph is nearly complete, it is factorised densely.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.records.growing_arrays import enlarged
from twc_env.slam.pose_graph.dense_cholesky import solution_of

DENSE_FROM = 24
"""Sparse elimination stops when every remaining node has at least this many neighbours ..."""
DENSE_SHARE = 0.15
"""... and at least this share of the remaining nodes; these are factorised densely."""


class BlockCholesky:
    """Factorisation of H, and solutions of H x = b, for H with blocks on the diagonal and at the given pairs.

    pairs (e, 2) int: block rows 0..count-1 of each edge; a pair with a negative row has no block. `block_of_pair` (e,)
    is the index of each pair's off-diagonal block (-1: none), which holds H[larger, smaller].
    """

    def __init__(self, pairs: Array, count: int):
        pattern = _eliminate(np.ascontiguousarray(pairs, np.int64), count, DENSE_FROM, DENSE_SHARE)
        self.block_of_pair = pattern[0]
        self.block_count = int(pattern[1])
        self.pattern = pattern[2:8]
        """The first six arguments of `factorise`."""
        self._rest, self._rest_pairs = pattern[8], pattern[9]
        self.has_dense_rest = len(self._rest) > 0
        """Whether some nodes are factorised densely."""

    def solve(self, diagonal: Array, blocks: Array, right: Array) -> Array | None:
        """x (count, 3) with H x = right (count, 3); None if H is not positive definite.

        diagonal (count, 3, 3) and blocks (k, 3, 3), indexed by `block_of_pair`, are not modified.
        """
        diagonal, solution = diagonal.copy(), right.copy()
        filled = np.zeros((self.block_count, 3, 3))
        filled[: len(blocks)] = blocks
        order, start, node_of = self.pattern[:3]
        lower = np.empty((len(node_of), 3, 3))
        if not factorise(*self.pattern, diagonal, filled, lower, solution):
            return None
        if self.has_dense_rest:
            found = solution_of(*_dense_rest(self._rest, self._rest_pairs, diagonal, filled, solution))
            if found is None:
                return None
            solution[self._rest] = found.reshape(-1, 3)
        substitute_back(order, start, node_of, diagonal, lower, solution)
        return solution


@kernel
def _eliminate(pairs, count, dense_from, dense_share):
    """Symbolic factorisation: minimum-degree elimination on linked lists of neighbours.

    Block k has the cells 2 k (list of the smaller node) and 2 k + 1. An eliminated node connects all its neighbours.
    """
    neighbour = np.empty(4 * len(pairs) + 16, np.int32)
    following = np.empty(len(neighbour), np.int32)
    head = np.full(count, -1, np.int32)
    degree = np.zeros(count, np.int32)
    block_of_pair = np.full(len(pairs), -1, np.int64)
    blocks = 0
    for e in range(len(pairs)):
        low, high = min(pairs[e, 0], pairs[e, 1]), max(pairs[e, 0], pairs[e, 1])
        if low < 0 or low == high:
            continue
        cell = head[high]
        while cell >= 0 and neighbour[cell] != low:
            cell = following[cell]
        if cell < 0:
            cell = 2 * blocks
            neighbour[cell], following[cell], head[low] = high, head[low], cell
            neighbour[cell + 1], following[cell + 1], head[high] = low, head[high], cell + 1
            degree[low] += 1
            degree[high] += 1
            blocks += 1
        block_of_pair[e] = cell >> 1

    first = np.full(count + 1, -1, np.int32)  # heads of doubly linked lists of nodes, one list per degree
    after, before = np.full(count, -1, np.int32), np.full(count, -1, np.int32)
    for node in range(count - 1, -1, -1):
        after[node] = first[degree[node]]
        if after[node] >= 0:
            before[after[node]] = node
        first[degree[node]] = node

    order, start = np.empty(count, np.int32), np.zeros(count + 1, np.int64)
    node_of, block_of = np.empty(4 * count + 16, np.int32), np.empty(4 * count + 16, np.int32)
    target_start, target = np.zeros(count + 1, np.int64), np.empty(4 * count + 16, np.int32)
    stamp, mark = np.full(count, -1, np.int64), np.empty(count, np.int32)
    is_gone = np.zeros(count, np.bool_)
    done, lowest, stamps = 0, 0, 0
    while done < count:
        while first[lowest] < 0:
            lowest += 1
        d = lowest
        if d >= dense_from and d >= dense_share * (count - done):
            break
        p = first[d]
        first[d] = after[p]
        if after[p] >= 0:
            before[after[p]] = -1
        is_gone[p] = True
        order[done] = p
        s = start[done]
        if s + d > len(node_of):
            node_of, block_of = enlarged(node_of, s + d), enlarged(block_of, s + d)
        cell = head[p]
        for k in range(d):
            node_of[s + k], block_of[s + k] = neighbour[cell], cell >> 1
            cell = following[cell]
        t = target_start[done]
        if t + d * (d - 1) // 2 > len(target):
            target = enlarged(target, t + d * (d - 1) // 2)
        for i in range(d):
            q = node_of[s + i]
            old = degree[q]
            if before[q] >= 0:  # remove q from the list of its degree
                after[before[q]] = after[q]
            elif first[old] == q:
                first[old] = after[q]
            if after[q] >= 0:
                before[after[q]] = before[q]
        for i in range(d):
            q = node_of[s + i]
            stamps += 1
            previous, cell = -1, head[q]
            while cell >= 0:
                other = neighbour[cell]
                if other == p:
                    if previous < 0:
                        head[q] = following[cell]
                    else:
                        following[previous] = following[cell]
                else:
                    stamp[other], mark[other] = stamps, cell >> 1
                    previous = cell
                cell = following[cell]
            degree[q] -= 1
            for j in range(i + 1, d):
                r = node_of[s + j]
                if stamp[r] == stamps:
                    target[t] = mark[r]
                else:
                    cell = 2 * blocks
                    if cell + 2 > len(neighbour):
                        neighbour, following = enlarged(neighbour, cell + 2), enlarged(following, cell + 2)
                    low, high = min(q, r), max(q, r)
                    neighbour[cell], following[cell], head[low] = high, head[low], cell
                    neighbour[cell + 1], following[cell + 1], head[high] = low, head[high], cell + 1
                    degree[q] += 1
                    degree[r] += 1
                    target[t] = blocks
                    blocks += 1
                t += 1
        for i in range(d):
            q = node_of[s + i]
            k = degree[q]
            before[q], after[q] = -1, first[k]
            if first[k] >= 0:
                before[first[k]] = q
            first[k] = q
            lowest = min(lowest, k)
        done += 1
        start[done], target_start[done] = s + d, t

    rest = np.empty(count - done, np.int64)
    place = np.full(count, -1, np.int64)
    m, cells = 0, 0
    for node in range(count):
        if not is_gone[node]:
            rest[m], place[node] = node, m
            m += 1
            cells += degree[node]
    rest_pairs = np.empty((cells // 2, 3), np.int64)  # row (larger), column, block
    m = 0
    for node in rest:
        cell = head[node]
        while cell >= 0:
            if neighbour[cell] < node:
                rest_pairs[m, 0], rest_pairs[m, 1], rest_pairs[m, 2] = place[node], place[neighbour[cell]], cell >> 1
                m += 1
            cell = following[cell]
    return (
        block_of_pair,
        blocks,
        order[:done].copy(),
        start[: done + 1].copy(),
        node_of[: start[done]].copy(),
        block_of[: start[done]].copy(),
        target_start[: done + 1].copy(),
        target[: target_start[done]].copy(),
        rest,
        rest_pairs,
    )


@borrowing_kernel
def factorise(order, start, node_of, block_of, target_start, target, diagonal, blocks, lower, right):
    """Numeric factorisation and forward substitution, in place; False if H is not positive definite.

    diagonal (n, 3, 3) receives the Cholesky factors, lower (k, 3, 3) the columns, right (n, 3) the forward solution.
    """
    for step in range(len(order)):
        p = order[step]
        if not diagonal[p, 0, 0] > 0.0:
            return False
        l00 = np.sqrt(diagonal[p, 0, 0])
        i00 = 1.0 / l00
        l10, l20 = diagonal[p, 1, 0] * i00, diagonal[p, 2, 0] * i00
        rest = diagonal[p, 1, 1] - l10 * l10
        if not rest > 0.0:
            return False
        l11 = np.sqrt(rest)
        i11 = 1.0 / l11
        l21 = (diagonal[p, 2, 1] - l20 * l10) * i11
        rest = diagonal[p, 2, 2] - l20 * l20 - l21 * l21
        if not rest > 0.0:
            return False
        l22 = np.sqrt(rest)
        diagonal[p, 0, 0], diagonal[p, 1, 0], diagonal[p, 2, 0] = l00, l10, l20
        diagonal[p, 1, 1], diagonal[p, 2, 1], diagonal[p, 2, 2] = l11, l21, l22
        i22 = 1.0 / l22
        y0 = right[p, 0] * i00
        y1 = (right[p, 1] - l10 * y0) * i11
        y2 = (right[p, 2] - l20 * y0 - l21 * y1) * i22
        right[p, 0], right[p, 1], right[p, 2] = y0, y1, y2
        begin, end = start[step], start[step + 1]
        for k in range(begin, end):
            q, block = node_of[k], block_of[k]
            for i in range(3):
                if q > p:
                    b0, b1, b2 = blocks[block, i, 0], blocks[block, i, 1], blocks[block, i, 2]
                else:
                    b0, b1, b2 = blocks[block, 0, i], blocks[block, 1, i], blocks[block, 2, i]
                w0 = b0 * i00
                w1 = (b1 - w0 * l10) * i11
                w2 = (b2 - w0 * l20 - w1 * l21) * i22
                lower[k, i, 0], lower[k, i, 1], lower[k, i, 2] = w0, w1, w2
                right[q, i] -= w0 * y0 + w1 * y1 + w2 * y2
        t = target_start[step]
        for a in range(begin, end):
            q = node_of[a]
            a00, a01, a02 = lower[a, 0, 0], lower[a, 0, 1], lower[a, 0, 2]
            a10, a11, a12 = lower[a, 1, 0], lower[a, 1, 1], lower[a, 1, 2]
            a20, a21, a22 = lower[a, 2, 0], lower[a, 2, 1], lower[a, 2, 2]
            diagonal[q, 0, 0] -= a00 * a00 + a01 * a01 + a02 * a02
            diagonal[q, 1, 0] -= a10 * a00 + a11 * a01 + a12 * a02
            diagonal[q, 1, 1] -= a10 * a10 + a11 * a11 + a12 * a12
            diagonal[q, 2, 0] -= a20 * a00 + a21 * a01 + a22 * a02
            diagonal[q, 2, 1] -= a20 * a10 + a21 * a11 + a22 * a12
            diagonal[q, 2, 2] -= a20 * a20 + a21 * a21 + a22 * a22
            for b in range(a + 1, end):
                block = target[t]
                t += 1
                is_below = q > node_of[b]
                for j in range(3):
                    v0, v1, v2 = lower[b, j, 0], lower[b, j, 1], lower[b, j, 2]
                    m0, m1, m2 = (
                        a00 * v0 + a01 * v1 + a02 * v2,
                        a10 * v0 + a11 * v1 + a12 * v2,
                        a20 * v0 + a21 * v1 + a22 * v2,
                    )
                    if is_below:
                        blocks[block, 0, j] -= m0
                        blocks[block, 1, j] -= m1
                        blocks[block, 2, j] -= m2
                    else:
                        blocks[block, j, 0] -= m0
                        blocks[block, j, 1] -= m1
                        blocks[block, j, 2] -= m2
    return True


@kernel
def _dense_rest(rest, pairs, diagonal, blocks, right):
    """Lower triangle of the remaining matrix, and its right-hand side (n,)."""
    size = 3 * len(rest)
    dense, part = np.zeros((size, size)), np.empty(size)
    for k in range(len(rest)):
        for i in range(3):
            part[3 * k + i] = right[rest[k], i]
            for j in range(i + 1):
                dense[3 * k + i, 3 * k + j] = diagonal[rest[k], i, j]
    for k in range(len(pairs)):
        row, column, block = 3 * pairs[k, 0], 3 * pairs[k, 1], blocks[pairs[k, 2]]
        for i in range(3):
            for j in range(3):
                dense[row + i, column + j] = block[i, j]
    return dense, part


@borrowing_kernel
def substitute_back(order, start, node_of, diagonal, lower, solution):
    """Backward substitution in place: solution (n, 3) holds the forward solution of `factorise`, then x."""
    for step in range(len(order) - 1, -1, -1):
        p = order[step]
        x0, x1, x2 = solution[p, 0], solution[p, 1], solution[p, 2]
        for k in range(start[step], start[step + 1]):
            q = node_of[k]
            s0, s1, s2 = solution[q, 0], solution[q, 1], solution[q, 2]
            x0 -= lower[k, 0, 0] * s0 + lower[k, 1, 0] * s1 + lower[k, 2, 0] * s2
            x1 -= lower[k, 0, 1] * s0 + lower[k, 1, 1] * s1 + lower[k, 2, 1] * s2
            x2 -= lower[k, 0, 2] * s0 + lower[k, 1, 2] * s1 + lower[k, 2, 2] * s2
        x2 = x2 / diagonal[p, 2, 2]
        x1 = (x1 - diagonal[p, 2, 1] * x2) / diagonal[p, 1, 1]
        x0 = (x0 - diagonal[p, 1, 0] * x1 - diagonal[p, 2, 0] * x2) / diagonal[p, 0, 0]
        solution[p, 0], solution[p, 1], solution[p, 2] = x0, x1, x2
