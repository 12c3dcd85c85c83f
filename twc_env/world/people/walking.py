"""One time step of all people: the walking ones head for their places, the standing ones step aside and come back."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel, parts_of
from twc_env.world.building.wall_index import is_blocked, wall_beside
from twc_env.world.people.social_force import RELAXATION_S, SPEED_EXCESS, interaction, wall_repulsion

WALKING, STANDING, SITTING = range(3)
X, Y, VX, VY, FACING, GAIT, PAUSE, SPEED, HOME_X, HOME_Y, LEFT, WAITED = range(12)
"""Columns of a person's state: position, velocity, direction of the body, phase of the gait [rad], rest of a pause
[s], speed wanted, place where a standing person stands, least way left [m] on this walk, and time since then [s]."""
COLUMNS = 12
BODY_RADIUS_M = 0.2
"""Of the disc that touches walls, robots and people."""
LEG_RADIUS_M, LEG_OFFSET_M, SEAT_RADIUS_M = 0.06, 0.1, 0.2
"""Shins, their distance from the middle of the body, and a sitting person with the chair, at the scanner's height."""
_STEP_LENGTH_M = 0.7
"""Of a walking person at normal speed; the legs swing by a third of it about the body."""
_SWING_M = _STEP_LENGTH_M / 3.0
_GAIT_SPEED_M_S = 1.3
_ARRIVAL_M = 0.5
_LOOK_AHEAD_CELLS = 3
_PATIENCE_S, _PROGRESS_M = 8.0, 0.3
"""A person who came no nearer within this time walks to the next place instead."""
_WALL_REACH_M = 0.6
_JUMP_M_S = 5.0
"""A robot faster than this was put down elsewhere: it has no velocity."""
_SEE_M = 1.0
"""Nearer than this, people notice each other even around a corner."""
_MAKES_WAY_M = 1.5
_PUSHING_COS = 0.5
"""A robot pushes a person if it drives in a direction within 60 degrees of theirs."""
SLOW_M_S = 0.05
"""A slower robot stands."""


@borrowing_kernel
def _way_from(field, origin, cell, x, y):
    """Direction of the way down a field of distances (rows, columns) from (x, y), and its length; 0, 0, -1 off it."""
    rows, columns = field.shape
    c = min(max(int(np.floor((x - origin[0]) / cell)), 0), columns - 1)
    r = min(max(int(np.floor((y - origin[1]) / cell)), 0), rows - 1)
    left = -1.0
    for step in range(_LOOK_AHEAD_CELLS):
        best, best_r, best_c = np.inf, r, c
        for reach in range(1, 4 if step == 0 else 2):  # further only from beside the ways, as behind an open door
            if not np.isinf(best):
                break
            for nr in range(max(r - reach, 0), min(r + reach + 1, rows)):
                for nc in range(max(c - reach, 0), min(c + reach + 1, columns)):
                    # Not around corners, except for who stands beside the ways.
                    if step > 0 and nr != r and nc != c and (np.isinf(field[r, nc]) or np.isinf(field[nr, c])):
                        continue
                    if field[nr, nc] < best:
                        best, best_r, best_c = field[nr, nc], nr, nc
        if np.isinf(best):
            break
        if step == 0:
            left = best
        r, c = best_r, best_c
    dx, dy = origin[0] + (c + 0.5) * cell - x, origin[1] + (r + 0.5) * cell - y
    size = max(math.sqrt(dx * dx + dy * dy), 1e-9)
    return dx / size, dy / size, left


@borrowing_kernel
def _wanted(i, state, kinds, trips, trip, pauses, fields, origin, cell, robots, dt):
    """Velocity that person i wants; advances its pauses and walks. Standing people let robots pass before they return
    to their places."""
    if kinds[i] == STANDING:
        for k in range(robots.shape[0]):
            if (robots[k, 0] - state[i, X]) ** 2 + (robots[k, 1] - state[i, Y]) ** 2 < _MAKES_WAY_M * _MAKES_WAY_M:
                return 0.0, 0.0
        dx, dy = state[i, HOME_X] - state[i, X], state[i, HOME_Y] - state[i, Y]
        size = math.sqrt(dx * dx + dy * dy)
        share = min(state[i, SPEED], size) / max(size, 1e-9)
        return share * dx, share * dy
    if state[i, PAUSE] > 0.0:
        state[i, PAUSE] -= dt
        return 0.0, 0.0
    k = trip[i] % trips.shape[1]
    ex, ey, left = _way_from(fields[trips[i, k]], origin, cell, state[i, X], state[i, Y])
    state[i, WAITED] += dt
    if left < state[i, LEFT] - _PROGRESS_M:
        state[i, LEFT], state[i, WAITED] = left, 0.0
    has_arrived = 0.0 <= left < _ARRIVAL_M
    if has_arrived or left < 0.0 or state[i, WAITED] > _PATIENCE_S:
        state[i, PAUSE] = pauses[i, k] if has_arrived else 0.0
        state[i, LEFT], state[i, WAITED] = np.inf, 0.0
        trip[i] += 1
        return 0.0, 0.0
    return state[i, SPEED] * ex, state[i, SPEED] * ey


@borrowing_kernel
def rim_beside(rims, x, y, reach):
    """Vector from the nearest of the rims (k, 4) to (x, y), and its length, at most `reach`."""
    best, from_x, from_y = reach * reach, 0.0, 0.0
    for k in range(rims.shape[0]):
        ax, ay = x - rims[k, 0], y - rims[k, 1]
        if abs(ax) > 3.0 or abs(ay) > 3.0:
            continue
        ex, ey = rims[k, 2] - rims[k, 0], rims[k, 3] - rims[k, 1]
        t = min(max((ax * ex + ay * ey) / max(ex * ex + ey * ey, 1e-12), 0.0), 1.0)
        dx, dy = ax - t * ex, ay - t * ey
        if dx * dx + dy * dy < best:
            best, from_x, from_y = dx * dx + dy * dy, dx, dy
    return from_x, from_y, math.sqrt(best)


@borrowing_kernel
def _accelerate(i, state, kinds, robots, radii, wanted_x, wanted_y, walls, rims):
    """Acceleration of person i by the speed wanted and by everybody near; robots (r, 4): positions and velocities."""
    x, y, vx, vy = state[i, X], state[i, Y], state[i, VX], state[i, VY]
    ax, ay = (wanted_x - vx) / RELAXATION_S, (wanted_y - vy) / RELAXATION_S
    bucket_walls, origin, bucket, rows, columns, first, members = walls
    for k in range(state.shape[0] + robots.shape[0]):
        if k == i:
            continue
        if k < state.shape[0]:
            ox, oy, ovx, ovy, margin = state[k, X], state[k, Y], state[k, VX], state[k, VY], 0.0
        else:
            m = k - state.shape[0]
            ox, oy, ovx, ovy = robots[m, 0], robots[m, 1], robots[m, 2], robots[m, 3]
            margin = radii[m] - BODY_RADIUS_M
        dx, dy = ox - x, oy - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > 4.0:
            continue
        near = max(distance - margin, 0.01) / max(distance, 1e-9)
        fx, fy = interaction(near * dx, near * dy, vx - ovx, vy - ovy)
        if fx * fx + fy * fy < 1e-3:
            continue
        if distance > _SEE_M and is_blocked(bucket_walls, origin, bucket, rows, columns, first, members, x, y, ox, oy):
            continue
        ax, ay = ax + fx, ay + fy
    wx, wy, gap = wall_beside(bucket_walls, origin, bucket, rows, columns, first, members, x, y, _WALL_REACH_M)
    if gap < _WALL_REACH_M:
        push = wall_repulsion(gap - BODY_RADIUS_M) / max(gap, 1e-9)
        ax, ay = ax + push * wx, ay + push * wy
    if rims.shape[0] > 0:
        wx, wy, gap = rim_beside(rims, x, y, _WALL_REACH_M)
        if gap < _WALL_REACH_M:
            push = wall_repulsion(gap - BODY_RADIUS_M) / max(gap, 1e-9)
            ax, ay = ax + push * wx, ay + push * wy
    return ax, ay


@borrowing_kernel
def _keep_apart(i, state, kinds, robots, radii, walls, rims):
    """Move person i out of robots, people, furniture and, last, walls."""
    bucket_walls, origin, bucket, rows, columns, first, members = walls
    for k in range(state.shape[0] + robots.shape[0]):
        if k == i:
            continue
        is_robot = k >= state.shape[0]
        ox = robots[k - state.shape[0], 0] if is_robot else state[k, X]
        oy = robots[k - state.shape[0], 1] if is_robot else state[k, Y]
        needed = BODY_RADIUS_M + (radii[k - state.shape[0]] if is_robot else BODY_RADIUS_M)
        dx, dy = state[i, X] - ox, state[i, Y] - oy
        distance = math.sqrt(dx * dx + dy * dy)
        if 1e-9 < distance < needed:
            state[i, X] += (needed - distance) * dx / distance
            state[i, Y] += (needed - distance) * dy / distance
    if rims.shape[0] > 0:
        wx, wy, gap = rim_beside(rims, state[i, X], state[i, Y], BODY_RADIUS_M)
        if 1e-9 < gap < BODY_RADIUS_M:
            state[i, X] += (BODY_RADIUS_M - gap) * wx / gap
            state[i, Y] += (BODY_RADIUS_M - gap) * wy / gap
    for _ in range(2):
        wx, wy, gap = wall_beside(
            bucket_walls, origin, bucket, rows, columns, first, members, state[i, X], state[i, Y], BODY_RADIUS_M
        )
        if not 1e-9 < gap < BODY_RADIUS_M:
            break
        state[i, X] += (BODY_RADIUS_M - gap) * wx / gap
        state[i, Y] += (BODY_RADIUS_M - gap) * wy / gap


@borrowing_kernel
def place_legs(state, kinds, discs):
    """Fill discs (2 people, 3): x, y, radius of the two legs of each person, or of the chair of a sitting one."""
    for i in range(state.shape[0]):
        c, s = math.cos(state[i, FACING]), math.sin(state[i, FACING])
        speed = math.sqrt(state[i, VX] ** 2 + state[i, VY] ** 2)
        swing = min(speed / _GAIT_SPEED_M_S, 1.0) * _SWING_M * math.sin(state[i, GAIT])
        for leg in range(2):
            side = LEG_OFFSET_M if leg == 0 else -LEG_OFFSET_M
            ahead = swing if leg == 0 else -swing
            k = 2 * i + leg
            if kinds[i] == SITTING:
                side, ahead = 0.0, 0.0
            discs[k, 0], discs[k, 1] = state[i, X] + c * ahead - s * side, state[i, Y] + s * ahead + c * side
            discs[k, 2] = SEAT_RADIUS_M if kinds[i] == SITTING else LEG_RADIUS_M


@borrowing_kernel
def walk(crowd, poses, commands):
    """Advance all people by one time step, away from robots at poses (r, 3), and take back the speed of commands (r, 2)
    of robots that push a person: a bumper stops them."""
    (
        state, kinds, trips, trip, pauses, fields, origin, cell, walls, robots, radii, dt, discs, _touching,
        _counts, rims, hiding, obstructions,
    ) = parts_of(crowd)  # fmt: skip
    for k in range(poses.shape[0]):
        robots[k, 2], robots[k, 3] = (poses[k, 0] - robots[k, 0]) / dt, (poses[k, 1] - robots[k, 1]) / dt
        if not robots[k, 2] ** 2 + robots[k, 3] ** 2 < _JUMP_M_S * _JUMP_M_S:
            robots[k, 2], robots[k, 3] = 0.0, 0.0
        robots[k, 0], robots[k, 1] = poses[k, 0], poses[k, 1]
    for i in range(state.shape[0]):
        if kinds[i] == SITTING:
            continue
        wanted_x, wanted_y = _wanted(i, state, kinds, trips, trip, pauses, fields, origin, cell, robots, dt)
        ax, ay = _accelerate(i, state, kinds, robots, radii, wanted_x, wanted_y, walls, rims)
        vx, vy = state[i, VX] + ax * dt, state[i, VY] + ay * dt
        speed, limit = math.sqrt(vx * vx + vy * vy), SPEED_EXCESS * state[i, SPEED]
        if speed > limit:
            vx, vy, speed = vx * limit / speed, vy * limit / speed, limit
        before_x, before_y = state[i, X], state[i, Y]
        state[i, X], state[i, Y] = before_x + vx * dt, before_y + vy * dt
        _keep_apart(i, state, kinds, robots, radii, walls, rims)
        state[i, VX], state[i, VY] = vx, vy
        if kinds[i] == WALKING and speed > 0.2:
            state[i, FACING] = math.atan2(vy, vx)
        state[i, GAIT] = (state[i, GAIT] + math.pi * speed * dt / _STEP_LENGTH_M) % (2.0 * math.pi)
    place_legs(state, kinds, discs)
    upright = 0
    for i in range(state.shape[0]):
        if kinds[i] != SITTING:
            hiding[upright, 0], hiding[upright, 1] = state[i, X], state[i, Y]
            upright += 1
    for k in range(obstructions.shape[0]):
        obstructions[k, 0], obstructions[k, 1] = hiding[k, 0], hiding[k, 1]
    for k in range(commands.shape[0]):
        for i in range(state.shape[0]):
            dx, dy = state[i, X] - poses[k, 0], state[i, Y] - poses[k, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance < radii[k] + BODY_RADIUS_M:
                forward = (dx * math.cos(poses[k, 2]) + dy * math.sin(poses[k, 2])) / max(distance, 1e-9)
                if abs(forward) > _PUSHING_COS and forward * commands[k, 0] > 0.0:
                    commands[k, 0] = 0.0


@borrowing_kernel
def touch(crowd, poses, is_touched):
    """Note which robots, now at poses (r, 3), touch a person (r,); counts contacts that robots begin by driving."""
    (
        state, _kinds, _trips, _trip, _pauses, _fields, _origin, _cell, _walls, robots, radii, dt, _discs,
        touching, counts, _rims, _hiding, _obstructions,
    ) = parts_of(crowd)  # fmt: skip
    for k in range(poses.shape[0]):
        reach = radii[k] + BODY_RADIUS_M
        vx, vy = (poses[k, 0] - robots[k, 0]) / dt, (poses[k, 1] - robots[k, 1]) / dt
        is_touched[k] = False
        for i in range(state.shape[0]):
            dx, dy = state[i, X] - poses[k, 0], state[i, Y] - poses[k, 1]
            distance2 = dx * dx + dy * dy
            is_near = distance2 < (reach - 1e-6) ** 2
            if is_near:
                is_touched[k] = True
                gained = (vx * dx + vy * dy) / max(math.sqrt(distance2), 1e-9)
                if not touching[k, i] and gained > SLOW_M_S and vx * vx + vy * vy < _JUMP_M_S * _JUMP_M_S:
                    counts[k] += 1
            touching[k, i] = is_near
