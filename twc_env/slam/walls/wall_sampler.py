"""Select the walls among candidates by Gibbs sampling over all of them against all readings.

Each ray from a router to a reading has an excess loss that must equal the sum of the walls on it. Candidates are
binary; their prior depends on the side of the path and couples neighbours along a wall.
"""

from __future__ import annotations

import numpy as np

from twc_env.kernels.compiled import kernel

COUPLING = 2.0
"""Log-odds coupling of neighbouring pieces. In flips of whole runs and in the energy it counts twice."""
_TAIL = 4.0
"""Degrees of freedom of the noise (Student's t), which limits the cost of outliers."""
_RUN_MAX = 50


@kernel
def find_crossings(ends, near, far, is_heard, first, members):
    """Pieces (p, 4) crossed by each ray near[i] -> far[i]: count into first, or fill members if it has capacity.

    Rays of piece j are members[first[j] : first[j + 1]].
    """
    total = 0
    for j in range(ends.shape[0]):
        x1, y1, x2, y2 = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
        ex, ey = x2 - x1, y2 - y1
        low_x, high_x, low_y, high_y = min(x1, x2), max(x1, x2), min(y1, y2), max(y1, y2)
        first[j] = total
        for i in range(near.shape[0]):
            if not is_heard[i]:
                continue
            px, py, qx, qy = near[i, 0], near[i, 1], far[i, 0], far[i, 1]
            if (px < low_x and qx < low_x) or (px > high_x and qx > high_x):
                continue
            if (py < low_y and qy < low_y) or (py > high_y and qy > high_y):
                continue
            dx, dy = qx - px, qy - py
            side_a = dx * (y1 - py) - dy * (x1 - px) >= 0.0
            side_b = dx * (y2 - py) - dy * (x2 - px) >= 0.0
            if side_a == side_b:
                continue
            side_p = ex * (py - y1) - ey * (px - x1) >= 0.0
            side_q = ex * (qy - y1) - ey * (qx - x1) >= 0.0
            if side_p == side_q:
                continue
            if members.shape[0] > total:
                members[total] = i
            total += 1
    first[ends.shape[0]] = total
    return total


@kernel
def _cost(error, variance, weight):
    return weight * 0.5 * (_TAIL + 1.0) * np.log(1.0 + error * error / (_TAIL * variance))


@kernel
def sample_walls(
    is_wall, summed, loss, first, members, before, after, base, excess, variance, weight, temperature, sweeps, random,
    on_count,
):  # fmt: skip
    """Gibbs sweeps and flips of whole runs, in place, at a temperature.

    The stationary distribution is not exactly the posterior: a mixed run is made uniform in one move without a reverse
    move. Exact sampling found slightly worse walls (`reproduce sfw-table1 --flats`), and the aim is the best state.
    is_wall (p,) and summed (rays,) loss on each ray are the state; base (p,) prior log-odds; on_count (p,) counts how
    often each piece was a wall, or is empty.
    """
    pieces, rays = is_wall.shape[0], summed.shape[0]
    stamp = np.full(rays, -1, np.int64)
    held = np.empty(rays)
    touched = np.empty(rays, np.int64)
    moves = 0
    for _ in range(sweeps):
        for j in range(pieces):
            sign = -1.0 if is_wall[j] else 1.0
            delta = 0.0  # cost of being a wall minus cost of not being one
            for m in range(first[j], first[j + 1]):
                i = members[m]
                error = excess[i] - summed[i]
                other = error - sign * loss[j]
                change = _cost(other, variance[i], weight[i]) - _cost(error, variance[i], weight[i])
                delta += sign * change
            odds = base[j] - delta
            for neighbour in (before[j], after[j]):
                if neighbour >= 0:
                    odds += COUPLING if is_wall[neighbour] else -COUPLING
            now = random.random() < 1.0 / (1.0 + np.exp(-odds / temperature))
            if now != is_wall[j]:
                is_wall[j] = now
                for m in range(first[j], first[j + 1]):
                    summed[members[m]] += sign * loss[j]
        for _ in range(pieces // 8 + 1):
            start = int(random.random() * pieces)
            length = 2 + int(random.random() * (_RUN_MAX - 2))
            target = random.random() < 0.5
            moves += 1
            count, gain, j, last = 0, 0.0, start, -1
            changed = 0
            left = before[start]
            while j >= 0 and length > 0:
                if is_wall[j] != target:
                    gain += base[j] if target else -base[j]
                    changed += 1
                    amount = loss[j] if target else -loss[j]
                    for m in range(first[j], first[j + 1]):
                        i = members[m]
                        if stamp[i] != moves:
                            stamp[i] = moves
                            held[i] = summed[i]
                            touched[count] = i
                            count += 1
                        summed[i] += amount
                if last >= 0:
                    gain -= 0.0 if is_wall[j] == is_wall[last] else -2.0 * COUPLING
                last = j
                j = after[j]
                length -= 1
            if changed == 0:
                continue
            if left >= 0:
                gain += _boundary(is_wall[left], is_wall[start], target)
            if j >= 0:
                gain += _boundary(is_wall[j], is_wall[last], target)
            for t in range(count):
                i = touched[t]
                gain += _cost(excess[i] - held[i], variance[i], weight[i])
                gain -= _cost(excess[i] - summed[i], variance[i], weight[i])
            if np.log(random.random()) * temperature < gain:
                k = start
                while k != j:
                    is_wall[k] = target
                    k = after[k]
            else:
                for t in range(count):
                    summed[touched[t]] = held[touched[t]]
        if on_count.shape[0] > 0:
            for j in range(pieces):
                if is_wall[j]:
                    on_count[j] += 1


@kernel
def _boundary(neighbour, old, new):
    """Change of the coupling between a run's end and its neighbour by the flip."""
    before = COUPLING if neighbour == old else -COUPLING
    after = COUPLING if neighbour == new else -COUPLING
    return after - before
