"""One robot's front end: sensor frames in, a smooth pose estimate and keyframes out."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import between, compose, inverse, wrap_angle
from twc_env.messages import Keyframe, SensorFrame, SignObservation
from twc_env.slam.mate_detection import StillDiscs, mark_mates
from twc_env.slam.odometry_filter import make_filter, motion_covariance
from twc_env.slam.radio_fingerprint import fingerprint
from twc_env.slam.scan_matching import LineField

Array = NDArray

INNOVATION_MAX_M = 0.4
INNOVATION_MAX_RAD = 0.25
"""A match that jumps further than this from the prediction is not believed."""
MATCHED_SHARE_MIN = 0.3
"""Nor is one that explains fewer of the beams."""
MOTION_STD_MIN = np.array([0.01, 0.01, 0.003])
"""Nothing is ever known better than this from one keyframe to the next [m, m, rad]."""


REDRAW_SPACING_M = 0.9
"""When the local map moves on, of the older keyframes every one this far along the path is drawn again."""
NOTHING_MATCHED = np.zeros((3, 3))


class RobotFrontEnd:
    """Odometry, gyro and scan matching against a local map, in the robot's own odom frame (it starts at 0, 0, 0)."""

    def __init__(self, robot: int, config: EnvConfig):
        self.robot = robot
        self._config = config.slam
        self._range_max_m = config.lidar.range_max_m
        self._mate_radius_m = (
            config.dynamics.robot_radius_m if config.slam.keyframe.mask_mates and config.robots > 1 else 0.0
        )
        self._still = StillDiscs()
        self._filter = make_filter(config.slam.odometry_filter)
        local = config.slam.local_map
        self._field = LineField(np.zeros(2), local.size_m, local.resolution_m, self._range_max_m)
        noise = config.slam.odometry_filter
        self._match_variance_m2 = noise.match_std_m**2 * noise.match_correlation
        self._recentre_m = max(0.5 * local.size_m - self._range_max_m - 1.0, 1.0)
        self._centre_m = np.zeros(2)
        self._keyframes: list[Keyframe] = []
        self._scans: deque = deque(maxlen=config.slam.keyframe.fingerprint_scans_max)
        self._readings: list[tuple[str, Array, float]] = []
        self._travel_m = 0.0
        self._time_s = 0.0
        self._steps_since_keyframe = 0
        self._match_information = NOTHING_MATCHED
        self.pose_odom = np.zeros(3)
        """(3,) the estimate after the latest frame."""

    def update(self, frame: SensorFrame) -> Keyframe | None:
        """Take in one frame; gives a keyframe when the robot has come to a new place."""
        self._predict(frame)
        scan, discs = mark_mates(frame.ranges_m, self._range_max_m, self._mate_radius_m)
        if self._keyframes:
            self._match(scan)
        x, y, heading, _ = self._filter.state.tolist()
        self.pose_odom = np.array([x, y, (heading + math.pi) % (2 * math.pi) - math.pi])
        self._remember_radio_and_signs(frame)
        if not self._is_new_place():
            return None
        self._still.unmark(scan, discs, self.pose_odom, self._travel_m, frame.time_s)
        keyframe = self._make_keyframe(frame, scan)
        self._keyframes.append(keyframe)
        self._extend_local_map(keyframe)
        return keyframe

    def _predict(self, frame: SensorFrame) -> None:
        dt_s = frame.time_s - self._time_s
        self._time_s = frame.time_s
        if dt_s <= 0.0:
            return
        self._filter.predict(frame.odometry, frame.turn_rate_rad_s, dt_s)
        dx, dy, _ = frame.odometry.tolist()
        self._travel_m += math.hypot(dx, dy)
        self._steps_since_keyframe += 1

    def _match(self, ranges_m: Array) -> None:
        local = self._config.local_map
        guess = self._filter.state[:3].copy()
        pose, information, share = self._field.match_scan(
            ranges_m, guess, local.match_distance_max_m, local.match_iterations_max, local.degenerate_share,
            self._match_variance_m2,
        )  # fmt: skip
        jump_x, jump_y, turn = (pose - guess).tolist()
        self._match_information = NOTHING_MATCHED
        if share < MATCHED_SHARE_MIN or math.hypot(jump_x, jump_y) > INNOVATION_MAX_M or abs(turn) > INNOVATION_MAX_RAD:
            return
        self._match_information = information
        self._filter.update(pose, information)

    def _remember_radio_and_signs(self, frame: SensorFrame) -> None:
        if frame.wifi is not None:
            self._scans.append((frame.time_s, frame.wifi))
        for sign in frame.signs:
            angle = self.pose_odom[2] + sign.bearing_rad
            position = self.pose_odom[:2] + sign.range_m * np.array([math.cos(angle), math.sin(angle)])
            facing = self._field.facing_at(position, self.pose_odom[:2])
            self._readings.append((sign.text, position, facing))

    def _is_new_place(self) -> bool:
        if not self._keyframes:
            return True
        rule = self._config.keyframe
        dx, dy, turn = (self.pose_odom - self._keyframes[-1].pose_odom).tolist()
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        return math.hypot(dx, dy) >= rule.distance_m or abs(turn) >= rule.turn_rad

    def _make_keyframe(self, frame: SensorFrame, scan: Array) -> Keyframe:
        rule = self._config.keyframe
        motion, covariance = np.zeros(3), np.zeros((3, 3))
        if self._keyframes:
            motion = between(self._keyframes[-1].pose_odom, self.pose_odom)
            covariance = motion_covariance(
                self._motion_variance(), self._keyframes[-1].pose_odom[2], 0.5 * self._match_information, MOTION_STD_MIN
            )
        recent = [scan for time_s, scan in self._scans if time_s > frame.time_s - rule.fingerprint_window_s]
        robot_odom = inverse(self.pose_odom)
        signs = tuple(
            SignObservation(text, compose(robot_odom, [*position, 0.0])[:2], float(wrap_angle(facing + robot_odom[2])))
            for text, position, facing in self._readings
        )
        self._readings = []
        self._steps_since_keyframe = 0
        return Keyframe(
            robot=self.robot,
            index=len(self._keyframes),
            step=frame.step,
            time_s=frame.time_s,
            pose_odom=self.pose_odom.copy(),
            motion=motion,
            motion_covariance=covariance,
            travel_m=self._travel_m,
            ranges_m=scan,
            signs=signs,
            fingerprint=fingerprint(recent, rule.fingerprint_detection_min, rule.std_mode, rule.fingerprint_age_max_s),
        )

    def _motion_variance(self) -> Array:
        """(3,) odometry's variances since the last keyframe [m2, m2, rad2]."""
        noise, steps = self._config.odometry_filter, self._steps_since_keyframe
        length = self._travel_m - self._keyframes[-1].travel_m
        moved = steps * noise.position_std_m**2 + length * noise.position_std_per_m**2
        return np.array([moved, moved, steps * noise.turn_std_rad**2])

    def _extend_local_map(self, keyframe: Keyframe) -> None:
        position = keyframe.pose_odom[:2]
        if np.hypot(*(position - self._centre_m)) <= self._recentre_m:
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
