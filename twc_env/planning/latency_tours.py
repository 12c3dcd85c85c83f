"""Tours of several robots over a known plan that show its floor early, with meetings after which floor counts.

Minimising the sum of the times at which each part of the floor is first seen is the travelling repairman problem
(Afrati et al., "The complexity of the travelling repairman problem", RAIRO 20, 1986), here with several robots, views
that overlap, and views on the way. Floor counts for the team only in its largest common map: two groups share a map
once they have read enough signs in common; where there are no signs, once they have been at as many places and their
robots have seen each other (`slam.merging.mutual_observations`). Tours are built greedily, by the gain of a view for
its way (Gonzalez-Banos and Latombe 2002), from several first meetings; the best is improved by moving, reversing and
exchanging parts (Or-opt and 2-opt: Or 1976; Croes 1958), each judged by playing the tours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.covering_walk import bit_count
from twc_env.planning.floor_views import FloorViews

STOPS_MAX = 64
"""Most stops of a tour."""
OTHERS_WEIGHT = 0.1
"""What floor is worth that is only in other maps than the largest, against floor in that."""
GAIN_MIN_CELLS = 6
"""A stop shows at least so many cells."""
EASY_TURN_RAD = 0.5
"""Robots turn by so much without losing time; for the rest of a turn they stand."""
LINK_PERIOD_S = 2.0
"""Robots with a mapper each pass on their maps at most this often."""


@dataclass(slots=True, eq=False)
class TeamState:
    """Where a team is and what it has done."""

    places: Array
    """(robots,) int64: the place of each robot; -1 before it first stands somewhere."""
    seen: Array
    """(robots, words) uint64: floor in the map of each robot; robots with a common map have the same."""
    is_merged: Array
    """(robots, robots) bool: which share a map."""
    read: Array
    """(robots, words) uint64: the signs that each has read (`FloorViews.marks`)."""
    poses: Array
    """(robots, 3) of each."""
    sightings: Array
    """(robots, robots) int64: how often two saw each other when one of them had come to another place."""

    @classmethod
    def begin(cls, robots: int, views: FloorViews) -> TeamState:
        """Nobody has been anywhere."""
        seen, read = np.zeros((robots, views.words), np.uint64), np.zeros((robots, views.marks.shape[1]), np.uint64)
        nowhere, sightings = np.full(robots, -1, np.int64), np.zeros((robots, robots), np.int64)
        return cls(nowhere, seen, np.eye(robots, dtype=bool), read, np.zeros((robots, 3)), sightings)

    def arrays(self) -> tuple[Array, ...]:
        """For kernels."""
        return self.places, self.seen, self.is_merged, self.read, self.poses, self.sightings

    def stand(self, robot: int, pose: Array, views: FloorViews) -> None:
        """Note that a robot is at a pose (3,); where there are no signs, it counts as one."""
        place = views.place_at(pose[:2])
        if not len(views.signs):
            self.read[robot] |= views.marks[place]
            if place != self.places[robot]:
                for other in np.flatnonzero(self.places >= 0):
                    is_seen = other != robot and views.sights[place, self.places[other]]
                    self.sightings[robot, other] += is_seen
                    self.sightings[other, robot] += is_seen
        self.places[robot], self.poses[robot] = place, pose


@dataclass(slots=True, eq=False)
class LatencyTours:
    """Plans the tours of a team."""

    views: FloorViews
    speeds_m_s: Array
    """(robots,) speed of each ..."""
    turn_rates_rad_s: Array
    """... and turn rate ..."""
    reverses: Array
    """... and whether it drives backwards rather than turning around, bool."""
    common_min: int = 3
    """About so many common signs merge two maps; or, where there are none, so many common squares of floor ..."""
    sightings_min: int = 4
    """... if robots have also seen each other about so often: chosen, of 4 and 8, on validation buildings 0 to 9 of
    `ExploreBare-v1`."""
    links: Array | None = None
    """(places, places) bool: whether robots at two places hear each other; None: all maps are made by a central mapper
    that hears everyone."""
    meetings_max: int = 24
    """Most places that are tried for a first meeting."""
    tours: Array = field(init=False)
    """(robots, `STOPS_MAX`) int64: the stops of each robot, in their order; -1 after the last."""

    def __post_init__(self) -> None:
        self.tours = np.full((len(self.speeds_m_s), STOPS_MAX), -1, np.int64)

    def plan(self, state: TeamState, horizon_s: float, tries: int, random: np.random.Generator) -> float:
        """Improve the tours from here on; returns the mean number of cells that count over the horizon.

        tries: how many changes are judged.
        """
        fixed = self._fixed(horizon_s)
        robots, places = len(state.places), len(self.views.graph.places_m)
        starts = [self.tours.copy()]
        starts += [np.full_like(self.tours, -1) for _ in range(2)]
        if not state.is_merged.all() or self.links is not None:
            for place in random.choice(places, min(self.meetings_max, places), replace=False):
                starts.append(np.full_like(self.tours, -1))
                starts[-1][:, 0] = place
            for robot in range(robots):  # all others drive to it, or to where they find its trail
                starts.append(np.full_like(self.tours, -1))
                starts[-1][np.arange(robots) != robot, 0] = state.places[robot]
        best, best_value = self.tours, -1.0
        for k, start in enumerate(starts):
            _fill(start, 0.1 if k % 2 else 0.25, state.arrays(), fixed)
            value = _value(start, state.arrays(), fixed)
            if value > best_value:
                best, best_value = start, value
        self.tours = best
        if tries and places > 1:
            best_value = _improve(self.tours, state.arrays(), fixed, self.views.graph.near, random.random((tries, 6)))
        return float(best_value / max(horizon_s, 1e-9))

    def value(self, state: TeamState, horizon_s: float) -> float:
        """The mean number of cells that count over the horizon, if the team drives these tours."""
        return float(_value(self.tours, state.arrays(), self._fixed(horizon_s)) / max(horizon_s, 1e-9))

    def advance(self, robot: int) -> None:
        """Drop the next stop of a robot."""
        self.tours[robot, :-1] = self.tours[robot, 1:]
        self.tours[robot, -1] = -1

    def _fixed(self, horizon_s: float) -> tuple:
        views, graph = self.views, self.views.graph
        links = np.ones((1, 1), bool) if self.links is None else self.links
        return (
            graph.lengths_m, graph.via, views.seen_words, views.seen_bits, views.marks, self.speeds_m_s,
            self.turn_rates_rad_s, self.reverses, graph.places_m,
            links, self.links is not None, self.common_min,
            views.sights, 0 if len(views.signs) else self.sightings_min, horizon_s,
        )  # fmt: skip


@kernel
def _count_common(first, second):
    """How many signs are in both masks (words,)."""
    common = 0
    for w in range(first.shape[0]):
        common += bit_count(first[w] & second[w])
    return common


@kernel
def _count_sightings(sightings, is_merged, a, b):
    """How often robots that share a map with robot a and those that share one with b have seen each other."""
    count = 0
    for c in range(sightings.shape[0]):
        for d in range(sightings.shape[0]):
            if is_merged[a, c] and is_merged[b, d]:
                count += sightings[c, d]
    return count


@kernel
def _look(mask, place, seen_words, seen_bits):
    """Add what is in view to a mask (words,); returns how many cells are new."""
    new = 0
    for k in range(seen_words.shape[1]):
        w = seen_words[place, k]
        if w < 0:
            break
        bits = seen_bits[place, k] & ~mask[w]
        if bits != 0:
            new += bit_count(bits)
            mask[w] |= bits
    return new


@kernel
def _count_new(mask, place, seen_words, seen_bits):
    """How many cells in view are not in a mask (words,)."""
    new = 0
    for k in range(seen_words.shape[1]):
        w = seen_words[place, k]
        if w < 0:
            break
        new += bit_count(seen_bits[place, k] & ~mask[w])
    return new


@kernel
def _fill(tours, decay, state, fixed):
    """Extend the tours greedily until nothing is left to see or the time is over."""
    places, seen = state[0], state[1]
    lengths, via, seen_words, seen_bits, speeds, horizon = fixed[0], fixed[1], fixed[2], fixed[3], fixed[5], fixed[14]
    robots = tours.shape[0]
    mask = np.zeros(seen.shape[1], np.uint64)
    at, ends, counts = places.copy(), np.zeros(robots), np.zeros(robots, np.int64)
    for robot in range(robots):
        mask |= seen[robot]
    for robot in range(robots):
        while counts[robot] < tours.shape[1] and tours[robot, counts[robot]] >= 0:
            goal = tours[robot, counts[robot]]
            ends[robot] += lengths[at[robot], goal] / speeds[robot]
            while at[robot] != goal:
                at[robot] = via[goal, at[robot]]
                _look(mask, at[robot], seen_words, seen_bits)
            counts[robot] += 1
    while True:
        robot = -1
        for other in range(robots):
            is_free = ends[other] < horizon and counts[other] < tours.shape[1]
            if is_free and (robot < 0 or ends[other] < ends[robot]):
                robot = other
        if robot < 0:
            return
        best, most = -1, 0.0
        for place in range(lengths.shape[0]):
            worth = math.exp(-decay * lengths[at[robot], place])
            if worth * 64 * seen_words.shape[1] <= most:
                continue
            new = _count_new(mask, place, seen_words, seen_bits)
            if new >= GAIN_MIN_CELLS and new * worth > most:
                best, most = place, new * worth
        if best < 0:
            ends[robot] = horizon
            continue
        if best == at[robot]:
            _look(mask, best, seen_words, seen_bits)
            continue
        tours[robot, counts[robot]] = best
        counts[robot] += 1
        ends[robot] += lengths[at[robot], best] / speeds[robot]
        while at[robot] != best:
            at[robot] = via[best, at[robot]]
            _look(mask, at[robot], seen_words, seen_bits)


@kernel
def _leg_s(x, y, goal, heading, length, speed, rate, reverses):
    """Time [s] that a robot with a heading (2,) needs to a goal (2,) at most `length` away, and its heading there."""
    dx, dy = goal[0] - x, goal[1] - y
    away = math.hypot(dx, dy)
    if away < 0.05:
        return 0.0, heading[0], heading[1]
    dx, dy = dx / away, dy / away
    turn = math.acos(max(-1.0, min(1.0, dx * heading[0] + dy * heading[1])))
    if reverses:
        turn = min(turn, math.pi - turn)
    return min(away, length) / speed + max(turn - EASY_TURN_RAD, 0.0) / rate, dx, dy


@kernel
def _value(tours, state, fixed):
    """Integral over time [s] of the cells in the largest common map, and a little of those in others only."""
    lengths, via, seen_words, seen_bits, marks, speeds, rates, reverses, places_m = fixed[:9]
    links, is_peer, common_min, sights, sightings_min, horizon = fixed[9:]
    at, seen, is_merged = state[0].copy(), state[1].copy(), state[2].copy()
    read, need = state[3].copy(), np.zeros((state[0].shape[0], state[0].shape[0]), np.int64)
    sightings = state[5].copy()
    robots, words = seen.shape
    held = np.arange(robots)  # the mask of each robot: that of the first robot of its group with a central mapper
    area, passed_s = np.zeros(robots, np.int64), np.full((robots, robots), -1e9)
    for a in range(robots):
        if not is_peer:
            for b in range(a):
                if is_merged[a, b] and held[a] == a:
                    held[a] = held[b]
            if held[a] != a:
                read[held[a]] |= read[a]
        for w in range(words):
            area[a] += bit_count(seen[a, w])
    for a in range(robots):
        for b in range(robots):  # one more will do where enough was not enough
            need[a, b] = max(common_min, 1 + _count_common(read[held[a]], read[held[b]]))
    together, total = np.zeros(words, np.uint64), 0
    for w in range(words):
        for a in range(robots):
            together[w] |= seen[a, w]
        total += bit_count(together[w])
    stop, due, ahead = np.zeros(robots, np.int64), np.full(robots, np.inf), at.copy()
    poses, heading = state[4], np.empty((robots, 2))
    for a in range(robots):
        heading[a, 0], heading[a, 1] = math.cos(poses[a, 2]), math.sin(poses[a, 2])
    for a in range(robots):
        while stop[a] < tours.shape[1] and tours[a, stop[a]] == at[a]:
            stop[a] += 1
        if stop[a] < tours.shape[1] and tours[a, stop[a]] >= 0:
            ahead[a] = via[tours[a, stop[a]], at[a]]
            due[a], heading[a, 0], heading[a, 1] = _leg_s(
                poses[a, 0],
                poses[a, 1],
                places_m[ahead[a]],
                heading[a],
                lengths[at[a], ahead[a]],
                speeds[a],
                rates[a],
                reverses[a],
            )
    now, value = 0.0, 0.0
    while True:
        most = 0
        for a in range(robots):
            if held[a] == a:
                most = max(most, area[a])
        r = int(np.argmin(due))
        step = min(due[r], horizon) - now
        value += step * (most + OTHERS_WEIGHT * (total - most))
        if due[r] >= horizon:
            return value
        now, at[r] = due[r], ahead[r]
        read[held[r]] |= marks[at[r]]
        if sightings_min > 0:
            for b in range(robots):
                if b != r and sights[at[r], at[b]]:
                    sightings[r, b] += 1
                    sightings[b, r] += 1
        total += _look(together, at[r], seen_words, seen_bits)
        area[held[r]] += _look(seen[held[r]], at[r], seen_words, seen_bits)
        for b in range(robots):
            if b == r or (not is_peer and held[b] == held[r]):
                continue
            if is_peer and (not links[at[r], at[b]] or now - passed_s[r, b] < LINK_PERIOD_S):
                continue
            if not is_merged[r, b]:
                if _count_common(read[held[r]], read[held[b]]) < need[r, b]:
                    continue
                if sightings_min > 0 and _count_sightings(sightings, is_merged, r, b) < sightings_min:
                    continue
                is_c, is_d = is_merged[r].copy(), is_merged[b].copy()
                for c in range(robots):
                    for d in range(robots):
                        if is_c[c] and is_d[d]:
                            is_merged[c, d] = is_merged[d, c] = True
            passed_s[r, b] = passed_s[b, r] = now
            first, second = held[r], held[b]
            if not is_peer:
                for c in range(robots):
                    if held[c] == second:
                        held[c] = first
            read[first] |= read[second]
            area[first] = 0
            for w in range(words):
                seen[first, w] |= seen[second, w]
                area[first] += bit_count(seen[first, w])
            if is_peer:
                seen[second], read[second], area[second] = seen[first], read[first], area[first]
        while stop[r] < tours.shape[1] and tours[r, stop[r]] == at[r]:
            stop[r] += 1
        due[r] = np.inf
        if stop[r] < tours.shape[1] and tours[r, stop[r]] >= 0:
            here, ahead[r] = at[r], via[tours[r, stop[r]], at[r]]
            leg_s, heading[r, 0], heading[r, 1] = _leg_s(
                places_m[here, 0],
                places_m[here, 1],
                places_m[ahead[r]],
                heading[r],
                lengths[here, ahead[r]],
                speeds[r],
                rates[r],
                reverses[r],
            )
            due[r] = now + leg_s


@kernel
def _insert(tour, position, place):
    """Insert a stop; the last one is lost if the tour is full, and the new one if it comes after that."""
    if position >= tour.shape[0]:
        return
    for k in range(tour.shape[0] - 1, position, -1):
        tour[k] = tour[k - 1]
    tour[position] = place


@kernel
def _remove(tour, position):
    """Remove a stop, and return it."""
    place = tour[position]
    for k in range(position, tour.shape[0] - 1):
        tour[k] = tour[k + 1]
    tour[tour.shape[0] - 1] = -1
    return place


@kernel
def _length(tour):
    """Number of stops."""
    count = 0
    while count < tour.shape[0] and tour[count] >= 0:
        count += 1
    return count


@kernel
def _improve(tours, state, fixed, near, draws):
    """Change the tours in place by moves (draws (tries, 6), uniform in [0, 1)) that raise their value; returns it."""
    robots = tours.shape[0]
    best, trial = _value(tours, state, fixed), tours.copy()
    for t in range(draws.shape[0]):
        kind, u, v, x, y, z = draws[t]
        a, b = int(u * robots), int(v * robots)
        count_a, count_b = _length(trial[a]), _length(trial[b])
        if kind < 0.35:  # Or-opt: up to three stops elsewhere
            if count_a == 0:
                continue
            i, many = int(x * x * count_a), 1 + int(z * 3)
            moved = np.full(many, -1, np.int64)
            for k in range(many):
                if i < _length(trial[a]):
                    moved[k] = _remove(trial[a], i)
            j = int(y * y * (_length(trial[b]) + 1))
            for k in range(many):
                if moved[k] >= 0:
                    _insert(trial[b], min(j + (k if z * 3 % 1.0 < 0.5 else 0), _length(trial[b])), moved[k])
        elif kind < 0.5:  # 2-opt: reverse a part
            if count_a < 2:
                continue
            i = int(x * x * (count_a - 1))
            j = i + 1 + int(y * y * (count_a - 1 - i))
            for k in range((j - i + 1) // 2):
                trial[a, i + k], trial[a, j - k] = trial[a, j - k], trial[a, i + k]
        elif kind < 0.6:  # two robots exchange the rest of their tours
            if a == b:
                continue
            i, j = int(x * (count_a + 1)), int(y * (count_b + 1))
            tail_a, tail_b = trial[a, i:].copy(), trial[b, j:].copy()
            trial[a, i:], trial[b, j:] = -1, -1
            for k in range(min(len(tail_b), tours.shape[1] - i)):
                trial[a, i + k] = tail_b[k]
            for k in range(min(len(tail_a), tours.shape[1] - j)):
                trial[b, j + k] = tail_a[k]
        elif kind < 0.85:  # another place near a stop, in its stead or as well
            if count_a == 0:
                continue
            i = int(x * x * count_a)
            place = near[trial[a, i], int(y * near.shape[1])]
            if z < 0.5:
                trial[a, i] = place
            else:
                _insert(trial[a], i + int(z > 0.75), place)
        elif kind < 0.92:  # to where another robot will be
            if count_b == 0 or a == b:
                continue
            _insert(trial[a], int(x * x * (count_a + 1)), trial[b, int(y * count_b)])
        else:
            if count_a == 0:
                continue
            _remove(trial[a], int(x * x * count_a))
        value = _value(trial, state, fixed)
        if value > best:
            best = value
            tours[:] = trial
        else:
            trial[:] = tours
    return best
