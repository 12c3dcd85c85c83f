"""Pose of one robot in a finished map that does not grow: of an earlier session, or the walls of any grid.

While it is lost, guesses come from places of the map that look like the robot's keyframes (texts, radio, scans, by the
recogniser of the settings); where the map or the robot has neither signs nor radio, also from a search of the robot's
recent scans over the whole map (`global_matching`). A pose is tried if guesses from several places agree, and no others
agree half as often: rooms look alike. From then on each scan is matched to the walls, starting from odometry. The robot
is no longer lost after `SURE_M` of path along which all scans fit well, and better than somewhat further along the
walls, and lost again when they fit too badly for longer than `PATIENCE_S` or `PATIENCE_M`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, inverse, transform_points, wrap_angle
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import GridMap, Keyframe
from twc_env.slam.mapping.map_saving import keyframes_of
from twc_env.slam.matching.global_matching import (
    CELL_M,
    REACH_MAX_M,
    GlobalMatch,
    match_globally,
    possible_places,
    turn_along_walls,
)
from twc_env.slam.matching.point_matching import GATE_LAST_M, match_to_tree
from twc_env.slam.matching.scan_matching import scan_points
from twc_env.slam.places.place_recognition import make_recogniser
from twc_env.slam.saved_maps.wall_axes import wall_axes

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

TRACKED_MIN, FOUND_MIN = 0.6, 0.75
"""Least fit to believe a match while tracking, and to believe a guess: the share of a scan's points on walls, less the
share of its beams that would have gone through walls."""
THROUGH_STEP_M, THROUGH_M = 0.1, 0.4
"""Spacing of the places on a beam that are looked up in the map, and how far before its end the last one is."""
SURE_M, SURE_SCANS = 3.0, 5
"""It is no longer lost after so long a path, and so many scans, that all fit as a guess must: a ring of corridors fits
three scans a metre apart from the wrong side too."""
PATIENCE_S, PATIENCE_M = 1.5, 1.5
"""It says that it is lost after so long a time or path without a match that it believes."""
SPACING_M, SPACING_RAD, SPACING_S = 0.1, 0.1, 1.0
"""A scan is matched when the robot has moved or turned so far since the last one that was, or after this time."""
GATE_M = 0.6
"""Points of a tracked scan further from a wall have no partner at first."""
MOVED_MAX_M, MOVED_MAX_RAD = 0.3, 0.1
"""A match further from odometry's prediction is not believed, but for the first of a streak while the robot is lost:
outside the map, a scan also fits turned or shifted walls."""
BESIDE_M = (0.6, 0.9, 1.2)
"""While it is lost, a match does not count that fits no better than it would so far along the walls."""
GAIN = 0.5
"""Of the way from odometry's prediction to the match, so much is gone: half, as both err."""
ROBOT, PLACES = 0, 1
"""Whose keyframes they are, for the recogniser: those of the robot, and the places of the map."""
AGREE_M, AGREE_RAD = 0.7, 0.15
"""Two guesses agree if the poses of the robot that they imply now differ by less."""
APART_M, VOTES_MIN = 2.0, 4
"""Guesses count once in such a length of path, one by a sign twice, and so many must agree."""
RECENT, PATIENT_SEARCHES, EVERY_MAX = 12, 40, 4
"""Keyframes whose scans are searched for together; after so many searches of each keyframe every second one is searched
for, after as many again every third one, up to the last number."""
SCALE_AT, SCALES, SCALE_MARGIN, SCALE_SAME = (10, 30, 100), 1.04 ** np.arange(-24, 19), 0.12, 0.1
"""After these searches in a grid it tries at which size the map would fit the scans. One must stand out by this score
from those that differ by more than this share, twice."""
SCORE_MIN, SQUARE_SHARE_MIN = 0.6, 0.3
"""Least score of the search of the whole map, and how dominant the directions of walls must be to lay them along each
other: many scans and a map tell them better than two scans."""
NEIGHBOURS = 25
"""Nearest cells whose main axis is the direction of a wall."""
GUESSES_MAX = 60
"""Latest guesses that wait for another that agrees."""


@dataclass(frozen=True, eq=False)
class Walls:
    """What robots are localised in, shared by all of them."""

    grid: GridMap
    tree: cKDTree
    """Of the centres of wall cells [m]."""
    places: tuple[Keyframe, ...]
    """Of an earlier session, as keyframes of another robot; none in a plain grid."""

    @classmethod
    def of(cls, known: LastingMap) -> Walls:
        """Raises DataError for a map without walls."""
        from scipy.spatial import cKDTree  # slow to import

        points = known.grid.centre_of(np.argwhere(known.grid.log_odds > 0))
        if not len(points):
            raise DataError("the map to localise in has no walls; choose another file")
        side_m = float(np.ptp(points, axis=0).max())
        if not len(known.poses) and side_m > 2.0 * REACH_MAX_M - 1.0:
            raise DataError(
                f"the map to localise in is {side_m:.0f} m long, and scans are searched for in up to "
                f"{2.0 * REACH_MAX_M:.0f} m: check its resolution, or cut it"
            )
        return cls(known.grid, cKDTree(points), tuple(keyframes_of(known, PLACES)))

    @cached_property
    def window(self) -> SearchWindow:
        """What a search of the whole map needs to know of it."""
        points, origin_m = self.tree.data, self.grid.origin_m
        middle_m = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle_m = origin_m + np.round((middle_m - origin_m) / CELL_M) * CELL_M
        half_m = 0.5 * float(np.ptp(points, axis=0).max())
        limit = 0 if self.grid.log_odds.min() < 0 else 1
        places = possible_places(lambda shifts: self.grid.level_at(shifts + middle_m) < limit, half_m)
        return SearchWindow(middle_m, half_m, places, _main_direction(points))


@dataclass(frozen=True, slots=True, eq=False)
class SearchWindow:
    """Where in a map a search looks for a robot."""

    middle_m: Array
    """(2,), so that centres of the grid's cells are centres of the search's: at their edges, rounding would choose."""
    half_m: float
    """Half of the side."""
    places: Array
    """`possible_places` on the free floor of the map; of a map that tells no free floor, on all but its walls."""
    walls: tuple[float, float]
    """Direction of the walls and how dominant it is, see `walls_run`."""


def _main_direction(points: Array) -> tuple[float, float]:
    """As `walls_run`, of points (n, 2) in any order, on walls of any thickness; straight stretches count most."""
    directions_rad, straight = wall_axes(CELL_M * np.unique(np.floor(points / CELL_M), axis=0), NEIGHBOURS)
    turn = (straight**4 * np.exp(4j * directions_rad)).sum() / max((straight**4).sum(), 1e-12)
    return float(np.angle(turn)) / 4, float(np.abs(turn))


class Localiser:
    """Finds and tracks one robot in a map."""

    def __init__(self, config: EnvConfig, walls: Walls):
        self._walls, self._range_max_m = walls, config.lidar.range_max_m
        self._recogniser = make_recogniser(config.slam.place_recognition, self._range_max_m)
        for place in walls.places:
            self._recogniser.propose(place, (PLACES,))
        self._has_cues = any(place.signs or len(place.fingerprint.macs) for place in walls.places)
        self._recent: list[Keyframe] = []
        self._searches, self._waited = 0, EVERY_MAX
        """Searches of the whole map since it was last found, and keyframes since the latest."""
        self._scales: list[float] = []
        """Sizes of the map, of its stated one, at which scans fitted it."""
        self._guesses: list[tuple[float, int, Array]] = []
        """Path length, weight, and implied pose of the odom frame in the map of guesses while lost."""
        self._odom = self._matched = np.zeros(3)
        """Latest pose in the odom frame, and that of the latest scan that was matched ..."""
        self._travel_m, self._matched_s = 0.0, -math.inf
        """... path so far, and that scan's time."""
        self._believed = -math.inf, -math.inf
        """Time and path of the last match that was believed."""
        self._streak = 0, 0.0
        """Scans that fit as a guess must, without one between that did not, and the path where they began."""
        self.pose_map_odom: Array | None = None
        """(3,) of the robot's odom frame in the map; None while no pose was ever tried."""
        self.is_lost = True
        """Whether it does not know where it is."""
        self.lost_share = 0.0
        """Share of the updates so far after which it was lost."""
        self._updates = 0
        self.fit = math.nan
        """How well the latest scan that was matched fits the map, see `TRACKED_MIN`."""

    def update(self, odom: Array, ranges_m: Array, keyframes: Sequence[Keyframe], time_s: float) -> None:
        """Take in the robot's next pose in the odom frame (3,), its scan (beams,) [m], and the keyframes taken since.

        Call it in order of time.
        """
        self._travel_m += math.dist(odom[:2], self._odom[:2])
        self._odom = odom
        away = between(self._matched, odom)
        is_due = math.hypot(away[0], away[1]) >= SPACING_M or abs(away[2]) >= SPACING_RAD
        if self.pose_map_odom is not None and (is_due or time_s - self._matched_s >= SPACING_S):
            points = scan_points(np.asarray(ranges_m), self._range_max_m)
            if len(points):
                self._track(odom, points, time_s)
        self.is_lost = self.is_lost or self._is_overdue(time_s)
        for keyframe in keyframes:
            if keyframe.begins_segment:
                self._begin()
            self._recent = [*self._recent[1 - RECENT :], keyframe]
            guesses = self._recognised(keyframe)  # also stores it as a place of its own
            if self.is_lost and self._streak[0] == 0:
                self._find([*guesses, *self._searched(keyframe)], keyframe, time_s)
        self._updates += 1
        self.lost_share += (self.is_lost - self.lost_share) / self._updates

    def _begin(self) -> None:
        """The robot was carried: nothing is known of where it is."""
        self.is_lost, self._streak, self._believed = True, (0, 0.0), (-math.inf, -math.inf)
        self._guesses.clear()
        self._recent.clear()

    def _is_overdue(self, time_s: float) -> bool:
        return time_s - self._believed[0] > PATIENCE_S or self._travel_m - self._believed[1] > PATIENCE_M

    def _track(self, odom: Array, points: Array, time_s: float) -> None:
        """Match a scan to the walls from the predicted pose."""
        assert self.pose_map_odom is not None
        self._matched, self._matched_s = odom, time_s
        predicted = compose(self.pose_map_odom, odom)
        match = match_to_tree(self._walls.tree, points, predicted, GATE_M)
        moved = between(predicted, match.pose)
        is_near = math.hypot(moved[0], moved[1]) <= MOVED_MAX_M and abs(moved[2]) <= MOVED_MAX_RAD
        is_near = is_near or (self.is_lost and self._streak[0] == 0)
        self.fit = match.inlier_ratio - self._through(match.pose, points)
        is_believed = is_near and self.fit >= (FOUND_MIN if self.is_lost else TRACKED_MIN)
        if not is_believed or (self.is_lost and self._fits_beside(match.pose, points)):
            self._streak = 0, 0.0
            return
        scans, begun_m = self._streak
        pose = compose(predicted, GAIN * moved) if scans else match.pose
        self.pose_map_odom, self._believed = compose(pose, inverse(odom)), (time_s, self._travel_m)
        self._streak = scans + 1, begun_m if scans else self._travel_m
        if scans + 1 >= SURE_SCANS and self._travel_m - self._streak[1] >= SURE_M:
            self.is_lost, self._searches = False, 0

    def _through(self, pose: Array, points: Array) -> float:
        """Share of beams to points (n, 2) that would have gone through walls of the map from this pose."""
        length_m = np.hypot(points[:, 0], points[:, 1])
        along_m = np.arange(THROUGH_STEP_M, max(length_m.max(), THROUGH_STEP_M) + THROUGH_STEP_M, THROUGH_STEP_M)
        at = transform_points(pose, (points / length_m[:, None])[:, None] * along_m[:, None])
        is_met = (self._walls.grid.level_at(at) > 0) & (along_m < length_m[:, None] - THROUGH_M)
        return float(is_met.any(axis=1).mean())

    def _fits_beside(self, pose: Array, points: Array) -> bool:
        """Whether points (n, 2) fit as well somewhat further along the walls, as in a corridor that shows its sides
        alone."""
        for turn_rad in (0.0, 0.5 * math.pi):
            along_rad = self._walls.window.walls[0] + turn_rad
            way_m = np.array([math.cos(along_rad), math.sin(along_rad), 0.0])
            for shift_m in (*BESIDE_M, *(-shift_m for shift_m in BESIDE_M)):
                beside = pose + shift_m * way_m
                away_m, _ = self._walls.tree.query(transform_points(beside, points), distance_upper_bound=GATE_LAST_M)
                if np.isfinite(away_m).mean() - self._through(beside, points) >= self.fit:
                    return True
        return False

    def _recognised(self, keyframe: Keyframe) -> list[tuple[int, Array]]:
        """Weights and poses (3,) of a keyframe in the map, by places of the map that look like it."""
        found = self._recogniser.propose(replace(keyframe, robot=ROBOT), (ROBOT,))
        return [
            (
                1 + (candidate.sign_m is not None),
                compose(self._walls.places[candidate.target[1]].pose_odom, candidate.guess),
            )
            for candidate in found
            if candidate.target[0] == PLACES
        ]

    def _searched(self, keyframe: Keyframe) -> list[tuple[int, Array]]:
        """Weight and pose (3,) of a keyframe at which its scan and those before it lie on walls, over the whole map."""
        if self._has_cues and any(recent.signs or len(recent.fingerprint.macs) for recent in self._recent):
            return []
        self._waited += 1
        if len(self._recent) < RECENT // 2 or self._waited < min(1 + self._searches // PATIENT_SEARCHES, EVERY_MAX):
            return []
        self._searches, self._waited = self._searches + 1, 0
        points = np.concatenate([
            transform_points(between(keyframe.pose_odom, k.pose_odom), scan_points(k.ranges_m, self._range_max_m))
            for k in self._recent
        ])  # fmt: skip
        if not len(points):
            return []
        if not self._walls.places and self.pose_map_odom is None and self._searches in SCALE_AT:
            self._try_scales(points)
        found = self._match(points, SCORE_MIN)
        return [] if found is None else [(1, found.pose + np.array([*self._walls.window.middle_m, 0.0]))]

    def _match(self, points: Array, score_min: float) -> GlobalMatch | None:
        """The pose, from the middle of the map, at which points (n, 2) lie best on walls of the map."""
        window, turn_rad = self._walls.window, self._turn_rad(points)
        return match_globally(
            self._walls.tree.data - window.middle_m, points, window.half_m, score_min, turn_rad, window.places
        )

    def _turn_rad(self, points: Array) -> float | None:
        return turn_along_walls(self._walls.window.walls, _main_direction(points), SQUARE_SHARE_MIN)

    def _try_scales(self, points: Array) -> None:
        """Note the size of the map at which the points (n, 2) fit, if one stands out.

        Not where walls have no main directions: so many searches of all headings would hold up the robot.
        """
        if self._turn_rad(points) is None:
            return
        found = [self._match(points / scale, SCORE_MIN - SCALE_MARGIN) for scale in SCALES.tolist()]
        scores = np.array([0.0 if match is None else match.score for match in found])
        best = int(np.argmax(scores))
        is_other = np.abs(SCALES / SCALES[best] - 1.0) > SCALE_SAME
        if scores[best] >= max(SCORE_MIN, scores[is_other].max() + SCALE_MARGIN):
            self._scales.append(float(SCALES[best]))

    @property
    def map_scale(self) -> float:
        """What the map's resolution would have to be multiplied by so that scans fit it; 1 if it seems right, as where
        a pose was tried."""
        found = np.array(self._scales)
        is_sure = len(found) > 1 and np.ptp(found) < SCALE_SAME * found.mean() and self.pose_map_odom is None
        return float(found.mean()) if is_sure and abs(found.mean() - 1.0) > SCALE_SAME else 1.0

    def _find(self, guesses: list[tuple[int, Array]], keyframe: Keyframe, time_s: float) -> None:
        """Refine guesses of a keyframe's pose; one that agrees with enough earlier ones is tried."""
        points, here = scan_points(keyframe.ranges_m, self._range_max_m), keyframe.pose_odom
        for weight, pose in guesses if len(points) else ():
            match = match_to_tree(self._walls.tree, points, pose)
            if match.inlier_ratio - self._through(match.pose, points) < FOUND_MIN:
                continue
            guess = compose(match.pose, inverse(here))
            self._guesses = [*self._guesses[1 - GUESSES_MAX :], (keyframe.travel_m, weight, guess)]
            votes, others = self._votes(compose(np.array([own for *_, own in self._guesses]), here))
            if votes >= VOTES_MIN and 2 * others <= votes:
                self.pose_map_odom, self._believed = guess, (time_s, self._travel_m)
                self._streak = 1, self._travel_m
                self._guesses.clear()
                return

    def _votes(self, poses: Array) -> tuple[int, int]:
        """How many votes the latest guess has, by the poses (k, 3) that all imply now; and the most of any other."""
        apart = between(poses[:, None], poses[None])
        agree = (np.hypot(apart[..., 0], apart[..., 1]) <= AGREE_M) & (np.abs(wrap_angle(apart[..., 2])) <= AGREE_RAD)
        is_rival = ~agree[-1]
        rivals = [self._counted(agree[k] & is_rival) for k in np.flatnonzero(is_rival).tolist()]
        return self._counted(agree[-1]), max(rivals, default=0)

    def _counted(self, chosen: Array) -> int:
        """Votes of some guesses (k,) bool: in each stretch of the path the weightiest counts."""
        votes: dict[int, int] = {}
        for k in np.flatnonzero(chosen).tolist():
            travel_m, weight, _ = self._guesses[k]
            stretch = int(travel_m / APART_M)
            votes[stretch] = max(votes.get(stretch, 0), weight)
        return sum(votes.values())
