"""Doors that swing, and robots and sight lines that end at door leaves and furniture; all are line segments."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.world.motion.dynamics import accelerated

HINGE_X, HINGE_Y, CLOSED_RAD, SIDE, LENGTH, ANGLE, GOAL, LEFT_S = range(8)
"""Columns of a door: hinge, direction of the closed leaf, side to which it opens (1: counter-clockwise), length of the
leaf, angle by which it is open, the one wanted, and time until it changes [s]."""
COLUMNS = 8
OPEN_RAD = 0.5 * math.pi
_SWING_RAD_S = OPEN_RAD / 1.5
"""A door opens or closes within 1.5 s."""
_OPENS_FOR_M = 1.2
"""People who walk open a door at this distance ..."""
_HELD_S = 3.0
"""... and hold it for this long after; one that is open anyway stays so for its own time, if that is longer."""
_PERSON_M = 0.25
_RANGE_MIN_M = 0.001


@borrowing_kernel
def away_from(segments, k, x, y):
    """Distance of (x, y) to segment k."""
    ax, ay = x - segments[k, 0], y - segments[k, 1]
    ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
    along = min(max((ax * ex + ay * ey) / max(ex * ex + ey * ey, 1e-12), 0.0), 1.0)
    return math.hypot(ax - along * ex, ay - along * ey)


@borrowing_kernel
def place_leaf(doors, k, angle, segments):
    """Write the leaf of door k, open by an angle, to segments (k, 4)."""
    heading = doors[k, CLOSED_RAD] + doors[k, SIDE] * angle
    segments[k, 0], segments[k, 1] = doors[k, HINGE_X], doors[k, HINGE_Y]
    segments[k, 2] = doors[k, HINGE_X] + doors[k, LENGTH] * math.cos(heading)
    segments[k, 3] = doors[k, HINGE_Y] + doors[k, LENGTH] * math.sin(heading)


@borrowing_kernel
def swing(doors, times, used, walkers, poses, radii, dt, seen, rims):
    """Move the doors by one time step.

    A leaf stops before robots at poses (r, 3), and one that closes before walkers (k, 2), who open it. times (doors,
    k): how long each stays closed and open, in turns; used (doors,): how often each has closed, for no time is used
    twice. The leaves are the first rows of seen and rims.
    """
    for k in range(doors.shape[0]):
        doors[k, LEFT_S] -= dt
        half = 0.5 * doors[k, LENGTH]
        x = doors[k, HINGE_X] + half * math.cos(doors[k, CLOSED_RAD])
        y = doors[k, HINGE_Y] + half * math.sin(doors[k, CLOSED_RAD])
        is_wanted = False
        for p in range(walkers.shape[0]):
            is_wanted |= (walkers[p, 0] - x) ** 2 + (walkers[p, 1] - y) ** 2 < _OPENS_FOR_M * _OPENS_FOR_M
        if is_wanted:
            doors[k, LEFT_S] = max(doors[k, LEFT_S], _HELD_S) if doors[k, GOAL] > 0.0 else _HELD_S
            doors[k, GOAL] = OPEN_RAD
        elif doors[k, LEFT_S] <= 0.0:
            opens = 0 if doors[k, GOAL] > 0.0 else 1
            doors[k, GOAL] = opens * OPEN_RAD
            used[k] += 1 - opens
            doors[k, LEFT_S] = times[k, (2 * used[k] + opens) % times.shape[1]]
        turn = min(max(doors[k, GOAL] - doors[k, ANGLE], -_SWING_RAD_S * dt), _SWING_RAD_S * dt)
        if turn == 0.0:
            continue
        place_leaf(doors, k, doors[k, ANGLE] + turn, rims)
        is_free = True
        for i in range(poses.shape[0]):
            is_free &= away_from(rims, k, poses[i, 0], poses[i, 1]) > radii[i] + 0.02
        for p in range(walkers.shape[0] if turn < 0.0 else 0):  # who opens a door steps aside
            is_free &= away_from(rims, k, walkers[p, 0], walkers[p, 1]) > _PERSON_M
        if is_free:
            doors[k, ANGLE] += turn
        place_leaf(doors, k, doors[k, ANGLE], rims)
        for column in range(4):
            seen[k, column] = rims[k, column]


@borrowing_kernel
def bump(rims, poses, state, limits, radii, dt, commands, is_touched):
    """Stop the robots at poses (r, 3) that would drive against rims (k, 4) in this step: their commands (r, 2) and
    state (r, 6) lose their speed; they may still turn, and drive away."""
    for i in range(commands.shape[0]):
        is_touched[i] = False
        vx, vy, _ = accelerated(state, i, commands, limits, dt)
        nx, ny = poses[i, 0] + vx * dt, poses[i, 1] + vy * dt
        reach = radii[i] + math.hypot(vx, vy) * dt
        for k in range(rims.shape[0]):
            if abs(rims[k, 0] - poses[i, 0]) > 3.0 or abs(rims[k, 1] - poses[i, 1]) > 3.0:
                continue
            now = away_from(rims, k, poses[i, 0], poses[i, 1])
            if now > reach:
                continue
            then = away_from(rims, k, nx, ny)
            if then < radii[i] and then < now:
                is_touched[i] = True
        if is_touched[i]:
            commands[i, 0], state[i, 3], state[i, 4] = 0.0, 0.0, 0.0


@borrowing_kernel
def shorten(segments, poses, directions, range_max, range_std, noise, used, end, ranges):
    """Shorten ranges (r, beams) [m] to segments (k, 4) that are nearer; else as `people.sight.shorten`."""
    beams = directions.shape[1]
    per_beam = beams / (2.0 * np.pi)
    for i in range(ranges.shape[0]):
        if end[i] - used[i] < beams:
            return False
    for i in range(ranges.shape[0]):
        x, y, c, s = poses[i, 0], poses[i, 1], math.cos(poses[i, 2]), math.sin(poses[i, 2])
        hits = 0
        for k in range(segments.shape[0]):
            wx, wy = segments[k, 0] - x, segments[k, 1] - y
            if abs(wx) > range_max + 2.0 or abs(wy) > range_max + 2.0:
                continue
            ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
            ax, ay, dx, dy = c * wx + s * wy, c * wy - s * wx, c * ex + s * ey, c * ey - s * ex
            bx, by = ax + dx, ay + dy
            begin, extent = math.atan2(ay, ax) * per_beam, math.atan2(ax * by - ay * bx, ax * bx + ay * by) * per_beam
            low, high = min(begin, begin + extent), max(begin, begin + extent)
            for n in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                b = n % beams
                closing = directions[0, b] * dy - directions[1, b] * dx
                if abs(closing) < 1e-12:
                    continue
                reach = (ax * dy - ay * dx) / closing
                if 0.0 < reach < ranges[i, b] and reach < range_max:
                    if range_std > 0.0 and hits < beams:
                        reach += range_std * noise[i, used[i] + hits]
                        hits += 1
                    ranges[i, b] = max(min(reach, ranges[i, b]), _RANGE_MIN_M)
        used[i] += hits
    return True
