"""The robots' front ends: sensor frames in, a smooth pose estimate and keyframes out.

What every step costs is computed for all robots at once, over common arrays; what a keyframe costs, robot by robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import between
from twc_env.kernels import kernel
from twc_env.messages import Keyframe, SensorFrame, SignObservation, SignReading
from twc_env.slam.mate_detection import MateMarker, StillDiscs
from twc_env.slam.odometry_filter import make_filters, motion_covariance
from twc_env.slam.radio_fingerprint import ScanWindow
from twc_env.slam.scan_matching import LineField, LineFields, Matches
from twc_env.team_messages import TeamFrames

Array = NDArray

MOTION_STD_MIN = (0.013, 0.013, 0.004)
"""Nothing is ever known better than this from one keyframe to the next [m, m, rad]."""
REDRAW_SPACING_M = 0.9
"""When the local map moves on, of the older keyframes every one this far along the path is drawn again."""


@kernel
def _arrive(
    robots, states, odometry, dts, keyframe_poses, explained, explained_min, distance, distance_new, turn, poses,
    travels, steps, is_new,
):  # fmt: skip
    """Poses after the step, path lengths, and whether each robot has come to a new place."""
    for a in range(robots.shape[0]):
        k = robots[a]
        poses[k, 0], poses[k, 1] = states[k, 0], states[k, 1]
        poses[k, 2] = (states[k, 2] + math.pi) % (2 * math.pi) - math.pi
        if dts[k] > 0.0:
            travels[k] += math.sqrt(odometry[k, 0] ** 2 + odometry[k, 1] ** 2)
            steps[k] += 1
        dx, dy = poses[k, 0] - keyframe_poses[k, 0], poses[k, 1] - keyframe_poses[k, 1]
        turned = (poses[k, 2] - keyframe_poses[k, 2] + math.pi) % (2 * math.pi) - math.pi
        share = 1.0 if explained[k] >= explained_min else distance_new / distance
        is_new[k] = not (math.sqrt(dx * dx + dy * dy) < share * distance and abs(turned) < share * turn)


class FrontEnds:
    """Odometry, gyro and scan matching against a local map, each robot in its own odom frame (it starts at 0, 0, 0).

    No robot's estimate depends on another's.
    """

    def __init__(self, config: EnvConfig, count: int):
        local, noise, beams = config.slam.local_map, config.slam.odometry_filter, config.lidar.beam_count
        self._rule, self._local = config.slam.keyframe, local
        masks = self._rule.mask_mates and config.robots > 1
        radius_m = config.dynamics.robot_radius_m if masks else 0.0
        self._marker = MateMarker(count, beams, config.lidar.range_max_m, radius_m)
        self._filters = make_filters(noise, count, config.slam.oracle != "poses")
        self._fields = LineFields(count, local.size_m, local.resolution_m, config.lidar.range_max_m, beams)
        self._match_variance_m2 = noise.match_std_m**2 * noise.match_correlation
        self._matches = Matches(count)
        self._has_lidar = config.slam.cues.lidar
        self._ranges_m, self._odometry = np.zeros((count, beams)), np.zeros((count, 3))
        self._turn_rates_rad_s, self._times_s, self._dts_s = np.zeros(count), np.zeros(count), np.zeros(count)
        self._travels_m, self._steps = np.zeros(count), np.zeros(count, np.int64)
        self._keyframe_poses = np.full((count, 3), np.nan)
        """Where each robot's last keyframe was taken; NaN before the first."""
        self._is_new = np.zeros(count, bool)
        self._everyone = np.arange(count)
        self.robots = [RobotFrontEnd(r, config, self._fields.fields[r]) for r in range(count)]
        """What each robot remembers for itself."""
        self.poses_odom = np.zeros((count, 3))
        """(n, 3) the estimates after the latest frames; a new array with every update."""

    def update(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Take in at most one frame per robot; gives a keyframe of each robot that has come to a new place."""
        robots = self._take_in(frames)
        self._filters.predict(robots, self._odometry, self._turn_rates_rad_s, self._dts_s)
        self._marker.mark(robots, self._ranges_m)
        self._match(robots)
        self.poses_odom = self.poses_odom.copy()
        _arrive(
            robots, self._filters.states, self._odometry, self._dts_s, self._keyframe_poses, self._matches.explained,
            self._rule.explained_min, self._rule.distance_m, self._rule.distance_new_m, self._rule.turn_rad,
            self.poses_odom, self._travels_m, self._steps, self._is_new,
        )  # fmt: skip
        return self._remember(frames, robots.tolist())

    def _take_in(self, frames: Sequence[SensorFrame]) -> Array:
        """Note what was measured; gives the robots (k,), one for each frame."""
        if isinstance(frames, TeamFrames):
            self._ranges_m[:], self._odometry[:] = frames.ranges_m, frames.odometry
            self._turn_rates_rad_s[:], self._dts_s[:] = frames.turn_rates_rad_s, frames.time_s - self._times_s
            self._times_s[:] = frames.time_s
            return self._everyone
        for frame in frames:
            k = frame.robot
            self._ranges_m[k] = frame.ranges_m
            self._odometry[k] = frame.odometry
            self._turn_rates_rad_s[k] = frame.turn_rate_rad_s
            self._dts_s[k] = frame.time_s - self._times_s[k]
            self._times_s[k] = frame.time_s
        return np.array([frame.robot for frame in frames])

    def _match(self, robots: Array) -> None:
        """Lay the scans on the local maps and correct the filters."""
        if not self._has_lidar:
            return
        states, matches = self._filters.states, self._matches
        self._fields.match(robots, self._marker.marked_m, states, self._local, self._match_variance_m2, matches)
        self._filters.update(robots, matches.poses, matches.information, matches.is_matched)

    def _remember(self, frames: Sequence[SensorFrame], robots: list[int]) -> list[Keyframe]:
        """Let each robot remember what it read and heard, and the place where that is a new one."""
        keyframes = []
        is_new, times_s = self._is_new.tolist(), self._times_s.tolist()
        team = frames if isinstance(frames, TeamFrames) else TeamFrames.of(frames)
        for k, wifi, signs in zip(robots, team.wifi, team.signs, strict=True):
            pose, robot, time_s = self.poses_odom[k], self.robots[k], times_s[k]
            robot.pose_odom = pose
            if wifi is not None:
                robot.radio.add(time_s, wifi)
            if signs:
                robot.read_signs(signs, pose)
            if is_new[k]:
                scan = self._marker.marked_m[k].copy()
                robot.still.unmark(scan, self._marker.discs_of(k), pose, self._travels_m[k], time_s)
                moved = float(self._travels_m[k]), int(self._steps[k])
                keyframe = robot.make_keyframe(team.step, time_s, scan, pose, *moved, self._matches.information[k])
                self._keyframe_poses[k], self._steps[k] = pose, 0
                keyframes.append(keyframe)
        return keyframes


class RobotFrontEnd:
    """What one robot remembers: keyframes, its local map, and what it read and heard since the last keyframe."""

    def __init__(self, robot: int, config: EnvConfig, field: LineField):
        self.robot = robot
        self._config = config.slam
        self._field = field
        self._centre_m = np.zeros(2)
        self._recentre_m = max(0.5 * config.slam.local_map.size_m - config.lidar.range_max_m - 1.0, 1.0)
        rule = config.slam.keyframe
        self.radio = ScanWindow(rule.fingerprint_scans_max)
        self.still = StillDiscs()
        self._keyframes: list[Keyframe] = []
        self._readings: list[tuple[str, float, float, float]] = []
        """Text, place [m, m] and facing [rad] in the odom frame of each sign read since the last keyframe."""
        self.pose_odom = np.zeros(3)
        """(3,) the estimate after the latest frame."""

    def read_signs(self, signs: Sequence[SignReading], pose_odom: Array) -> None:
        """Note the signs of a frame with the walls they hang on."""
        x, y, heading = pose_odom.tolist()
        for sign in signs:
            angle = heading + sign.bearing_rad
            place = x + sign.range_m * math.cos(angle), y + sign.range_m * math.sin(angle)
            self._readings.append((sign.text, *place, self._field.facing_at(place, (x, y))))

    def make_keyframe(
        self, step: int, time_s: float, scan: Array, pose_odom: Array, travel_m: float, steps: int, matched: Array
    ) -> Keyframe:
        """Remember this place and draw it into the local map.

        scan (beams,) with mates marked, steps since the last keyframe, matched (3, 3) information of the last match.
        """
        rule = self._config.keyframe
        motion, covariance = np.zeros(3), np.zeros((3, 3))
        if self._keyframes:
            last = self._keyframes[-1]
            motion = between(last.pose_odom, pose_odom)
            variance = self._motion_variance(steps, travel_m - last.travel_m)
            covariance = motion_covariance(variance, last.pose_odom[2], 0.5 * matched, MOTION_STD_MIN)
        keyframe = Keyframe(
            robot=self.robot,
            index=len(self._keyframes),
            step=step,
            time_s=time_s,
            pose_odom=pose_odom.copy(),
            motion=motion,
            motion_covariance=covariance,
            travel_m=travel_m,
            ranges_m=scan,
            signs=self._signs_seen_from(pose_odom),
            fingerprint=self.radio.fingerprint(
                time_s - rule.fingerprint_window_s,
                rule.fingerprint_detection_min,
                rule.std_mode,
                rule.fingerprint_age_max_s,
            ),
        )
        self._keyframes.append(keyframe)
        self._extend_local_map(keyframe)
        return keyframe

    def _signs_seen_from(self, pose_odom: Array) -> tuple[SignObservation, ...]:
        """The signs read since the last keyframe, in the frame of this one."""
        if not self._readings:
            return ()
        px, py, heading = pose_odom.tolist()
        c, s = math.cos(heading), math.sin(heading)
        signs = tuple(
            SignObservation(
                text,
                np.array([c * (x - px) + s * (y - py), c * (y - py) - s * (x - px)]),
                (facing - heading + math.pi) % (2 * math.pi) - math.pi,
            )
            for text, x, y, facing in self._readings
        )
        self._readings = []
        return signs

    def _motion_variance(self, steps: int, length_m: float) -> tuple[float, float, float]:
        """Odometry's variances since the last keyframe [m2, m2, rad2]."""
        noise = self._config.odometry_filter
        moved = steps * noise.position_std_m**2 + length_m * noise.position_std_per_m**2
        return moved, moved, steps * noise.turn_std_rad**2

    def _extend_local_map(self, keyframe: Keyframe) -> None:
        position = keyframe.pose_odom[:2]
        if math.dist(position, self._centre_m) <= self._recentre_m:
            self._field.add(keyframe.pose_odom[None], keyframe.ranges_m[None])
            return
        self._centre_m = position
        self._field.reset(position)
        horizon = keyframe.travel_m - self._config.local_map.memory_m
        recent = [keyframe]
        for old in reversed(self._keyframes[:-1]):
            if old.travel_m < horizon:
                break
            if recent[-1].travel_m - old.travel_m >= REDRAW_SPACING_M:
                recent.append(old)
        self._field.add(np.array([k.pose_odom for k in recent]), np.array([k.ranges_m for k in recent]))
