"""Track all robots: odometry and gyro, removal of teammates from the scan, scan matching, test for a new keyframe.

One compiled call processes all robots; their estimates are independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, parts_of
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import UNSEEN_M
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.front_end.scan_intake import ScanIntake
from twc_env.slam.matching.scan_matching import LineFields, match_scan, matching_room
from twc_env.slam.odometry.filters import make_filters
from twc_env.slam.odometry.odometry_filter import (
    CompiledFilters,
    anchor,
    believe_match,
    motion_noise,
    open_direction,
    predict_state,
)
from twc_env.slam.places.radio_fingerprint import NO_AGES, ScanWindows, ages_of, keep
from twc_env.slam.scans.deskewing import limit_open
from twc_env.slam.scans.lost_beams import bridge, mark_lost, opening_beams
from twc_env.slam.scans.scan_continuity import BUMP_MAX_M, BUMPED_MIN, agreement, continues, is_explained
from twc_env.slam.scans.teammate_detection import DISCS_MAX, mark_teammates


@borrowing_kernel
def _see(
    robots, ranges, has_scan, states, directions, opening, free, is_soft, mask_radii, marked, discs, disc_counts,
    cells, lines, origins, rule, has_lidar, room, matched, information, is_matched, is_clear, explained,
):  # fmt: skip
    """Mark lost beams and teammates in the scans and match the rest to the fields, near the robots' states.

    Without a scan, what a robot's last match explained and constrained stays.
    """
    (is_jump, jumps), (is_lost, bridged), for_match = room
    for a in range(robots.shape[0]):
        k = robots[a]
        if not has_scan[a]:
            disc_counts[k], is_matched[k], is_clear[k] = 0, False, False
            marked[k, :] = UNSEEN_M
            continue
        scan, has_lost = ranges[a], False
        if opening > 1:
            scan, has_lost = bridged, bridge(ranges[a], rule[0], opening, is_lost, bridged)
        disc_counts[k] = mark_teammates(scan, rule[0], mask_radii, directions, is_jump, jumps, marked[k], discs[k])
        if has_lost:
            mark_lost(is_lost, marked[k])
        mark_lost(is_soft[k], marked[k])
        limit_open(marked[k], rule[0], free[k])
        if has_lidar:
            is_matched[k], is_clear[k], explained[k] = match_scan(
                cells[k], lines[k], origins[k], marked[k], directions, rule, states[k], for_match, matched[k],
                information[k],
            )  # fmt: skip


@borrowing_kernel
def _arrive(robots, odometry, dts, has_scan, states, explained, rule, keyframe_poses, poses, travels, steps, is_new):
    """Poses after the step, path lengths, and whether each robot needs a new keyframe, for which it needs a scan.

    rule: minimum share of explained beams of a known place; distance to a new keyframe, distance where less is known,
    turn, and steps after which even a robot that stands needs one. Returns whether any robot needs one.
    """
    has_arrived = False
    for a in range(robots.shape[0]):
        k = robots[a]
        poses[k, 0], poses[k, 1] = states[k, 0], states[k, 1]
        poses[k, 2] = (states[k, 2] + math.pi) % (2 * math.pi) - math.pi
        if dts[a] > 0.0:
            travels[k] += math.sqrt(odometry[a, 0] ** 2 + odometry[a, 1] ** 2)
            steps[k] += 1
        dx, dy = poses[k, 0] - keyframe_poses[k, 0], poses[k, 1] - keyframe_poses[k, 1]
        turned = (poses[k, 2] - keyframe_poses[k, 2] + math.pi) % (2 * math.pi) - math.pi
        share = 1.0 if explained[k] >= rule[0] else rule[2] / rule[1]
        is_near = math.sqrt(dx * dx + dy * dy) < share * rule[1] and abs(turned) < share * rule[3]
        is_new[k] = has_scan[a] and (not is_near or steps[k] >= rule[4])
        has_arrived |= is_new[k]
    return has_arrived


@borrowing_kernel
def _note_open(robots, before, states, information, by_odometry):
    """Add to by_odometry (n, 2) the motion from before (n, 2) along directions that matched scans left open, in odom
    frames.

    Nothing is added where no scan was matched.
    """
    for a in range(robots.shape[0]):
        k = robots[a]
        is_open, ahead, left = open_direction(information[k])
        if is_open:
            along = ahead * (states[k, 0] - before[k, 0]) + left * (states[k, 1] - before[k, 1])
            by_odometry[k, 0] += along * ahead
            by_odometry[k, 1] += along * left


@borrowing_kernel
def _track(
    apparatus, robots, ranges, has_scan, odometry, turn_rates, now_s, poses, whose, macs, levels, ages, heard
):  # fmt: skip
    """A complete step with the compiled filters, including WiFi scans; returns whether any robot needs a new
    keyframe."""
    (
        scans_before, poses_before, moved, range_max, is_carried, motion,
        states, covariances, noise, believes_scans, directions, opening, free, is_soft, mask_radii, marked, discs,
        disc_counts, cells, lines, origins, match_rule, has_lidar, room, information, keyframe_rule, keyframe_poses,
        times, travels, steps, is_new, by_odometry, dts, matched, is_matched, is_clear, explained, before, kept_scans,
    ) = parts_of(apparatus)  # fmt: skip
    keep(kept_scans, now_s, robots, whose, macs, levels, ages, heard)
    for a in range(robots.shape[0]):
        k = robots[a]
        dts[a] = now_s - times[k]
        times[k] = now_s
        is_carried[k] = False
        if dts[a] > 0.0:
            _move_on(moved[k], odometry[a])
            is_misread = False
            if has_lidar and believes_scans and has_scan[a] and scans_before[k, 0] != 0.0:
                is_carried[k] = not continues(scans_before[k], ranges[a], moved[k], range_max, directions)
                if is_carried[k]:
                    variance_m2, variance_rad2 = motion_noise(moved[k, 0], moved[k, 1], noise[k])
                    is_misread = is_explained(
                        scans_before[k], ranges[a], moved[k], math.sqrt(variance_m2), math.sqrt(variance_rad2),
                        range_max, directions, motion,
                    )  # fmt: skip
                    is_carried[k] = not is_misread
        before[k, 0], before[k, 1] = states[k, 0], states[k, 1]
        if dts[a] > 0.0:
            predict_state(states[k], covariances[k], odometry[a], turn_rates[a], dts[a], noise[k])
            if is_misread:  # both scans tell the motion better than odometry, and matching begins there
                c, s = math.cos(poses_before[k, 2]), math.sin(poses_before[k, 2])
                states[k, 0] = poses_before[k, 0] + c * motion[0] - s * motion[1]
                states[k, 1] = poses_before[k, 1] + s * motion[0] + c * motion[1]
                states[k, 2] += motion[2] - moved[k, 2]
    _see(
        robots, ranges, has_scan, states, directions, opening, free, is_soft, mask_radii, marked, discs, disc_counts,
        cells, lines, origins, match_rule, has_lidar, room, matched, information, is_matched, is_clear, explained,
    )  # fmt: skip
    for a in range(robots.shape[0]):
        k = robots[a]
        if is_carried[k] and is_matched[k]:  # bumped, if the scan continues the one before by the matched motion
            _motion_to(poses_before[k], matched[k], motion)
            share = agreement(scans_before[k], ranges[a], motion, range_max, directions)
            read = math.hypot(moved[k, 0], moved[k, 1])
            is_carried[k] = math.hypot(motion[0], motion[1]) > read + BUMP_MAX_M or share < BUMPED_MIN
        if has_scan[a]:
            moved[k, 0], moved[k, 1], moved[k, 2] = 0.0, 0.0, 0.0
            for i in range(ranges.shape[1]):
                scans_before[k, i] = ranges[a, i]
        if is_carried[k]:
            is_matched[k] = False
            information[k, :, :] = 0.0
        if is_matched[k] and believes_scans:
            is_matched[k] = believe_match(
                states[k], covariances[k], matched[k], information[k], noise[k, 5], is_clear[k]
            )
            if not is_matched[k]:
                information[k, :, :] = 0.0
    if has_lidar:
        _note_open(robots, before, states, information, by_odometry)
    has_arrived = _arrive(
        robots, odometry, dts, has_scan, states, explained, keyframe_rule, keyframe_poses, poses, travels, steps, is_new
    )
    if not has_lidar:
        anchor(covariances, robots, is_new)
    for a in range(robots.shape[0]):
        k = robots[a]
        has_arrived |= is_carried[k]
        is_new[k] |= is_carried[k]
        if has_scan[a]:
            poses_before[k, 0], poses_before[k, 1], poses_before[k, 2] = poses[k, 0], poses[k, 1], poses[k, 2]
    return has_arrived


@borrowing_kernel
def _move_on(pose, motion):
    """Move a pose (3,) by a motion (3,) in its own frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * motion[0] - s * motion[1]
    pose[1] += s * motion[0] + c * motion[1]
    pose[2] += motion[2]


@borrowing_kernel
def _motion_to(before, now, motion):
    """Write motion (3,) from one pose to another."""
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = now[0] - before[0], now[1] - before[1]
    motion[0], motion[1] = c * dx + s * dy, c * dy - s * dx
    motion[2] = (now[2] - before[2] + math.pi) % (2 * math.pi) - math.pi


class Tracker(BindsAnew):
    """Poses of all robots, each in its own odom frame (start at 0, 0, 0), matched to their local maps."""

    def __init__(self, config: EnvConfig, count: int, intake: ScanIntake | None = None):
        """intake: that of the scans; None: they come from scanners without limits."""
        self.radio = ScanWindows(count, config.slam.keyframe.fingerprint_scans_max)
        """Recent WiFi scans of each robot."""
        noise, beams, rule = config.slam.odometry_filter, config.lidar.circle_beam_count, config.slam.keyframe
        assumed = [own.slam.odometry_filter for own in robot_configs(config)] if config.robot else noise
        self._filters = make_filters(assumed, count, config.slam.oracle != "poses")
        variance_m2 = noise.match_std_m**2 * noise.match_correlation
        robot_radius_m = config.dynamics.robot_radius_m
        fields = LineFields(count, config.slam.local_map, config.lidar, variance_m2, robot_radius_m)
        self.fields = fields
        """The local maps of all robots."""
        self.poses_odom = np.zeros((count, 3))
        """(n, 3) estimates after the latest frames; a new array after every update."""
        self.marked_m = np.zeros((count, beams))
        """(n, beams) scans; beams on teammates and beams that may be lost are negative: free up to there, but no
        wall."""
        self._scans_before = np.zeros((count, beams))
        """(n, beams) latest scans as received; zeros before the first."""
        self._poses_before, self._moved = np.zeros((count, 3)), np.zeros((count, 3))
        """(n, 3) poses at these scans, and motions by odometry since then."""
        self._range_max_m = config.lidar.range_max_m
        self.is_carried = np.zeros(count, bool)
        """(n,) whether each robot's latest scan shows another place than the one before (`scan_continuity`)."""
        self.discs, self.disc_counts = np.zeros((count, DISCS_MAX, 4)), np.zeros(count, np.int64)
        """A row (x [m], y [m], first beam, beams) for each teammate in the last scan, centre in the robot frame; and
        their number (n,)."""
        self.information = np.zeros((count, 3, 3))
        """(n, 3, 3) information of the latest matches; zeros if not matched."""
        self.keyframe_poses = np.full((count, 3), np.nan)
        """(n, 3) pose of each robot's last keyframe; NaN before the first. Written by the code that takes keyframes."""
        self.times_s, self.travels_m, self.steps = np.zeros(count), np.zeros(count), np.zeros(count, np.int64)
        """(n,) per robot: time of its latest frame, path length, steps since its last keyframe."""
        self.is_new, self.has_arrived = np.zeros(count, bool), False
        """(n,) whether each robot needs a new keyframe; and whether any in the latest frames does."""
        self._by_odometry_m = np.zeros((count, 2))
        """Motion that no scan constrained since `take_by_odometry` was last called, in the odom frames."""
        self._has_been_alone = [False] * count
        """Whether each robot ever moved by odometry alone."""
        masks = rule.mask_teammates and config.robots > 1
        radii_m = {own.dynamics.robot_radius_m for own in robot_configs(config)} if masks else set()
        opening = opening_beams(beams, config.lidar.dropout_probability)
        intake = intake or ScanIntake(config, count)
        self._marking = (
            beam_directions(beams), opening, intake.free_m, intake.is_soft, np.array(sorted(radii_m)), self.marked_m,
            self.discs, self.disc_counts,
        )  # fmt: skip
        self._all_scanned = np.ones(count, bool)
        for_teammates = np.empty(beams, bool), np.empty(beams + 1, np.int64)
        for_lost = np.zeros(beams, bool), np.empty(beams)
        room = for_teammates, for_lost, matching_room(beams)
        self._has_lidar = config.slam.cues.lidar
        self._matching = (fields.cells, fields.lines, fields.origins_m, fields.rule, self._has_lidar, room)
        self._run: Callable[..., bool] | None = None
        """`_track` bound to its constant arguments."""
        still_steps = rule.still_s / config.dynamics.time_step_s or math.inf
        self._keyframe_rule = np.array(
            [rule.explained_min, rule.distance_m, rule.distance_new_m, rule.turn_rad, still_steps]
        )

    def update(self, robots: Array, frames: TeamFrames) -> None:
        """Process the frames of these robots (k,), one row each."""
        self.poses_odom = self.poses_odom.copy()
        whose, macs, rssi_dbm, counts = frames.scans
        if macs.shape[1] > self.radio.width:
            self.radio.widen(macs.shape[1])
            self._run = None
        ages_s = ages_of(frames.wifi) if frames.may_repeat_readings else NO_AGES
        has_scan = self._all_scanned[: len(robots)] if frames.has_scan is None else frames.has_scan
        now = (
            robots, frames.ranges_m, has_scan, frames.odometry, frames.turn_rates_rad_s, frames.time_s, self.poses_odom,
            whose, macs, rssi_dbm, ages_s, counts,
        )  # fmt: skip
        if self._run is None:
            if not isinstance(self._filters, CompiledFilters):
                self._update_stepwise(robots, frames, has_scan)
                keep(self.radio.kept, frames.time_s, robots, *now[7:])
                return
            self._run = bound(_track, self._packed(self._filters), *now)
        self.has_arrived = self._run(*now)

    def take_by_odometry(self, robot: int) -> tuple[()] | tuple[tuple[float, float], tuple[float, float]]:
        """The motion that no scan constrained since the last call, along the robot's axes [m].

        And the odometry scale error with its standard deviation. Empty while scans constrained all motion.
        """
        x, y = self._by_odometry_m[robot].tolist()
        if x == y == 0.0 and not self._has_been_alone[robot]:
            return ()
        self._by_odometry_m[robot], self._has_been_alone[robot] = 0.0, True
        heading_rad = self.poses_odom[robot, 2]
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        scale, variance = self._filters.states[robot, 4], self._filters.covariances[robot, 4, 4]
        return (c * x + s * y, c * y - s * x), (float(scale), math.sqrt(variance))

    def _packed(self, filters: CompiledFilters) -> Lent:
        """The constant arguments of `_track`."""
        count = len(self.poses_odom)
        is_matched, is_clear = np.zeros(count, bool), np.zeros(count, bool)
        room = np.empty(count), np.empty((count, 3)), is_matched, is_clear, np.zeros(count), np.empty((count, 2))
        parts = (
            self._scans_before, self._poses_before, self._moved, self._range_max_m, self.is_carried, np.empty(3),
            filters.states, filters.covariances, filters.noise, filters.believes_scans, *self._marking,
            *self._matching, self.information, self._keyframe_rule, self.keyframe_poses, self.times_s,
            self.travels_m, self.steps, self.is_new, self._by_odometry_m, *room, self.radio.kept,
        )  # fmt: skip
        return Lent(parts)

    def _update_stepwise(self, robots: Array, frames: TeamFrames, has_scan: Array) -> None:
        """The same for filters that are not compiled."""
        count = len(self.poses_odom)
        matched, explained = np.empty((count, 3)), np.zeros(count)
        is_matched, is_clear = np.zeros(count, bool), np.zeros(count, bool)
        dts_s = frames.time_s - self.times_s[robots]
        self.times_s[robots] = frames.time_s
        before = self._filters.states[:, :2].copy()
        self._filters.predict(robots, frames.odometry, frames.turn_rates_rad_s, dts_s)
        _see(
            robots, frames.ranges_m, has_scan, self._filters.states, *self._marking, *self._matching, matched,
            self.information, is_matched, is_clear, explained,
        )  # fmt: skip
        self._filters.update(robots, matched, self.information, is_matched, is_clear)
        self.information[robots[~is_matched[robots] & has_scan]] = 0.0
        if self._has_lidar:
            _note_open(robots, before, self._filters.states, self.information, self._by_odometry_m)
        self.has_arrived = _arrive(
            robots, frames.odometry, dts_s, has_scan, self._filters.states, explained, self._keyframe_rule,
            self.keyframe_poses, self.poses_odom, self.travels_m, self.steps, self.is_new,
        )  # fmt: skip
        if not self._has_lidar:
            self._filters.anchor(robots, self.is_new)
