"""The robots' front ends: sensor frames in, a smooth pose estimate and keyframes out.

What every step costs is computed for all robots at once, over common arrays; what a keyframe costs, robot by robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.kernels import kernel
from twc_env.messages import Keyframe, SensorFrame, SignObservation, SignReading
from twc_env.slam.mate_detection import StillDiscs
from twc_env.slam.odometry_filter import motion_covariance
from twc_env.slam.radio_fingerprint import NO_AGES, ScanWindows, ages_of
from twc_env.slam.scan_matching import LineField
from twc_env.slam.tracking import Tracker
from twc_env.team_messages import TeamFrames

Array = NDArray

MOTION_STD_MIN = (0.013, 0.013, 0.004)
"""Nothing is ever known better than this from one keyframe to the next [m, m, rad]."""
REDRAW_SPACING_M = 0.9
"""When the local map moves on, of the older keyframes every one this far along the path is drawn again."""


@kernel
def _measure_motion(
    last, pose, steps, length, step_variance, metre_variance, turn_variance, matched, motion, covariance
):
    """Where a pose (3,) lies in the frame of the last keyframe's, and the covariance of that, in its own frame.

    Odometry's variances grow with every step and every metre; the last match tells half of what it says of the pose.
    """
    c, s = math.cos(last[2]), math.sin(last[2])
    dx, dy = pose[0] - last[0], pose[1] - last[1]
    motion[0], motion[1] = c * dx + s * dy, c * dy - s * dx
    motion[2] = (pose[2] - last[2] + math.pi) % (2 * math.pi) - math.pi
    moved = steps * step_variance + length * metre_variance
    motion_covariance((moved, moved, steps * turn_variance), pose[2], 0.5 * matched, MOTION_STD_MIN, covariance)


class FrontEnds:
    """Odometry, gyro and scan matching against a local map, each robot in its own odom frame (it starts at 0, 0, 0).

    No robot's estimate depends on another's.
    """

    def __init__(self, config: EnvConfig, count: int):
        self._tracker = Tracker(config, count)
        self._radio = ScanWindows(count, config.slam.keyframe.fingerprint_scans_max)
        self._everyone = np.arange(count)
        self.robots = [RobotFrontEnd(r, config, f, self._radio) for r, f in enumerate(self._tracker.fields)]
        """What each robot remembers for itself."""

    @property
    def poses_odom(self) -> Array:
        """(n, 3) the estimates after the latest frames; another array after every update."""
        return self._tracker.poses_odom

    def update(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Take in at most one frame per robot; gives a keyframe of each that came to a new place."""
        if isinstance(frames, TeamFrames):
            self._tracker.update(self._everyone, frames)
            return self._remember(self._everyone, frames)
        keyframes = []
        for together in of_one_time(frames):
            robots, team = np.array([frame.robot for frame in together]), TeamFrames.of(together)
            self._tracker.update(robots, team)
            keyframes += self._remember(robots, team)
        return keyframes

    def _remember(self, robots: Array, frames: TeamFrames) -> list[Keyframe]:
        """Let each robot remember what it read and heard, and the place where that is a new one."""
        keyframes, tracker, is_new = [], self._tracker, self._tracker.is_new.tolist()
        scans = frames.scans
        if len(scans.counts):
            ages_s = ages_of(frames.wifi) if frames.may_repeat_readings else NO_AGES
            receivers = scans.robots if robots is self._everyone else robots[scans.robots]
            self._radio.add(frames.time_s, receivers, scans, ages_s)
        for k, signs in zip(robots.tolist(), frames.signs, strict=True):
            if signs:
                self.robots[k].read_signs(signs, tracker.poses_odom[k])
            if is_new[k]:
                keyframes.append(self._take_keyframe(k, frames.step, frames.time_s))
        return keyframes

    def _take_keyframe(self, k: int, step: int, time_s: float) -> Keyframe:
        tracker, robot = self._tracker, self.robots[k]
        scan, pose, travel_m = tracker.marked_m[k].copy(), tracker.poses_odom[k], float(tracker.travels_m[k])
        robot.still.unmark(scan, tracker.discs_of(k), pose, travel_m, time_s)
        steps, tracker.steps[k] = int(tracker.steps[k]), 0
        tracker.keyframe_poses[k] = pose
        return robot.make_keyframe(step, time_s, scan, pose, travel_m, steps, tracker.information[k])


def of_one_time(frames: Sequence[SensorFrame]) -> list[list[SensorFrame]]:
    """Frames of robots whose clocks may differ, as in recordings: those of one step and time together."""
    together: dict[tuple[int, float], list[SensorFrame]] = {}
    for frame in frames:
        together.setdefault((frame.step, frame.time_s), []).append(frame)
    return list(together.values())


class RobotFrontEnd:
    """What one robot remembers: keyframes, its local map, and what it read and heard since the last keyframe."""

    def __init__(self, robot: int, config: EnvConfig, field: LineField, radio: ScanWindows):
        """field: of its local map; radio: the scans that the robots heard last."""
        self.robot = robot
        self._config = config.slam
        self._field, self._radio = field, radio
        self._centre_m = 0.0, 0.0
        self._recentre_m = max(0.5 * config.slam.local_map.size_m - config.lidar.range_max_m - 1.0, 1.0)
        noise = config.slam.odometry_filter
        self._variances = noise.position_std_m**2, noise.position_std_per_m**2, noise.turn_std_rad**2
        """Odometry's, of a step [m2], of a metre [m2] and of the turn in a step [rad2]."""
        self.still = StillDiscs()
        self._keyframes: list[Keyframe] = []
        self._readings: list[tuple[str, float, float, float]] = []
        """Text, place [m, m] and facing [rad] in the odom frame of each sign read since the last keyframe."""

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
            moved = steps, travel_m - last.travel_m
            _measure_motion(last.pose_odom, pose_odom, *moved, *self._variances, matched, motion, covariance)
        since_s = time_s - rule.fingerprint_window_s
        fingerprint = self._radio.fingerprint(
            self.robot, since_s, rule.fingerprint_detection_min, rule.std_mode, rule.fingerprint_age_max_s
        )
        keyframe = Keyframe(
            self.robot, len(self._keyframes), step, time_s, pose_odom.copy(), motion, covariance, travel_m, scan,
            self._signs_seen_from(pose_odom), fingerprint,
        )  # fmt: skip
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

    def _extend_local_map(self, keyframe: Keyframe) -> None:
        x, y, _ = keyframe.pose_odom.tolist()
        if math.hypot(x - self._centre_m[0], y - self._centre_m[1]) <= self._recentre_m:
            self._field.add(keyframe.pose_odom[None], keyframe.ranges_m[None])
            return
        self._centre_m = x, y
        self._field.reset(keyframe.pose_odom[:2])
        horizon = keyframe.travel_m - self._config.local_map.memory_m
        recent = [keyframe]
        for old in reversed(self._keyframes[:-1]):
            if old.travel_m < horizon:
                break
            if recent[-1].travel_m - old.travel_m >= REDRAW_SPACING_M:
                recent.append(old)
        self._field.add(np.array([k.pose_odom for k in recent]), np.array([k.ranges_m for k in recent]))
