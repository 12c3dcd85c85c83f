"""Which pieces of a lattice are walls: Metropolis sampling of all of them against all readings at once.

The readings of a router stray together where places are near: shadowing is a Gaussian process, whose inverse covariance
stands in `precision`. With `pull`, the inverse covariance times the errors, a few pieces can be changed at little cost.
"""

from __future__ import annotations

import numpy as np

from twc_env.kernels import kernel

_WALL_ODDS = -0.5
"""Log-odds of a piece being a wall, ..."""
_COUPLING, _BESIDE = 2.0, 4.0
"""... raised by a wall before or after it as by none it is lowered, and lowered by each wall beside it."""
_RUN_MAX = 21
"""So many pieces of one line are changed together, or moved to a line beside it."""


@kernel
def sample_lattice(
    is_wall, is_open, before, after, beside, first, members, crossed, loss, precision, pull, temperature, sweeps,
    random, times_crossed,
):  # fmt: skip
    """Sweeps over all pieces, in place; times_crossed (rays, k + 1) counts the walls of each ray, or is empty.

    Ray i of router r is i - r places of the precision (routers, places, places), and bends over the legs of crossed
    (rays, legs), whose mean loss it has; leg m of piece j is members[first[j] : first[j + 1]]. loss (k + 1,) [dB].
    """
    pieces, (rays, legs), places = is_wall.shape[0], crossed.shape, precision.shape[1]
    counts = crossed.reshape(-1)
    most = loss.shape[0] - 1
    stamp, change = np.full(counts.shape[0], -1, np.int64), np.zeros(counts.shape[0], np.int64)
    ray_stamp, less = np.full(rays, -1, np.int64), np.zeros(rays)
    touched, ray_touched = np.empty(counts.shape[0], np.int64), np.empty(rays, np.int64)
    chosen = np.empty(2 * _RUN_MAX, np.int64)
    moves = 0
    for _ in range(sweeps):
        for step in range(pieces + pieces // 3):
            if step < pieces:
                count = int(is_open[step])
                chosen[0] = step
            else:
                count = _choose_run(is_wall, is_open, after, beside, random, chosen)
            if count == 0:
                continue
            moves += 1
            gain, leg_count, ray_count = 0.0, 0, 0
            for c in range(count):
                j = chosen[c]
                odds = _WALL_ODDS
                if before[j] >= 0:
                    odds += _COUPLING if is_wall[before[j]] else -_COUPLING
                if after[j] >= 0:
                    odds += _COUPLING if is_wall[after[j]] else -_COUPLING
                for b in beside[j]:
                    if b >= 0 and is_wall[b]:
                        odds -= _BESIDE
                sign = -1 if is_wall[j] else 1
                gain += sign * odds
                is_wall[j] = not is_wall[j]
                for m in members[first[j] : first[j + 1]]:
                    if stamp[m] != moves:
                        stamp[m], change[m], touched[leg_count] = moves, 0, m
                        leg_count += 1
                    change[m] += sign
            for t in range(leg_count):
                m = touched[t]
                lost = loss[min(counts[m] + change[m], most)] - loss[min(counts[m], most)]
                if lost != 0.0:
                    i = m // legs
                    if ray_stamp[i] != moves:
                        ray_stamp[i], less[i], ray_touched[ray_count] = moves, 0.0, i
                        ray_count += 1
                    less[i] -= lost / legs
            for t in range(ray_count):
                i = ray_touched[t]
                r, place = i // places, i % places
                gain -= less[i] * (pull[i] + 0.5 * less[i] * precision[r, place, place])
                for other in ray_touched[:t]:
                    if other // places == r:
                        gain -= less[i] * less[other] * precision[r, place, other % places]
            if step < pieces:
                is_taken = random.random() < 1.0 / (1.0 + np.exp(-gain / temperature))
            else:
                is_taken = np.log(random.random()) * temperature < gain
            if not is_taken:
                for j in chosen[:count]:
                    is_wall[j] = not is_wall[j]
                continue
            for m in touched[:leg_count]:
                counts[m] += change[m]
            for i in ray_touched[:ray_count]:
                r = i // places
                for place in range(places):
                    pull[r * places + place] += less[i] * precision[r, i % places, place]
        if times_crossed.shape[0] > 0:
            for i in range(rays):
                times_crossed[i, min(crossed[i, legs // 2], times_crossed.shape[1] - 1)] += 1


@kernel
def _choose_run(is_wall, is_open, after, beside, random, chosen):
    """Fill the pieces of a run that is all wall or all none, or those that change when a run moves beside; how many."""
    j = int(random.random() * is_wall.shape[0])
    length = 2 + int(random.random() * (_RUN_MAX - 1))
    is_flip, line, was = random.random() < 0.5, int(random.random() * beside.shape[1]), is_wall[j]
    count = 0
    for _ in range(length):
        if j < 0 or not is_open[j]:
            return 0
        if is_flip:
            if is_wall[j] != was:
                return 0
            chosen[count] = j
            count += 1
        else:
            other = beside[j, line]
            if other < 0 or not is_open[other]:
                return 0
            if is_wall[j] != is_wall[other]:
                chosen[count], chosen[count + 1] = j, other
                count += 2
        j = after[j]
    return count
