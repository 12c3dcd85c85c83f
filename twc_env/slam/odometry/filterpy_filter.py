"""The filters of `odometry_filter` on filterpy's ExtendedKalmanFilter, as a reference implementation for tests."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray as Array

from twc_env.config import OdometryFilterConfig
from twc_env.records.geometry import wrap_angle
from twc_env.slam.odometry.odometry_filter import (
    INFORMATION_MIN,
    LATEST_SHARE,
    first_covariance,
    motion_noise,
    part_from_untold,
    process_values,
)


class FilterpyFilters:
    """One filter per robot; interface of `CompiledFilters`."""

    def __init__(self, config: OdometryFilterConfig | Sequence[OdometryFilterConfig], count: int):
        own = [config] * count if isinstance(config, OdometryFilterConfig) else config
        self._gate = own[0].match_gate
        self._values = [process_values(each) for each in own]
        self._filters = [ExtendedKalmanFilter(dim_x=5, dim_z=3) for _ in range(count)]
        self._readings = np.zeros((count, 2))
        for ekf, each in zip(self._filters, own, strict=True):
            ekf.x = np.zeros(5)
            ekf.P = first_covariance(each)

    @property
    def states(self) -> Array:
        """See `CompiledFilters`."""
        return np.column_stack([[ekf.x for ekf in self._filters], self._readings])

    @property
    def covariances(self) -> Array:
        """(n, 5, 5) state covariances."""
        return np.array([ekf.P for ekf in self._filters])

    def predict(self, robots: Array, odometry: Array, turn_rates_rad_s: Array, dts_s: Array) -> None:
        """See `CompiledFilters`."""
        for k, motion, turn_rate, dt_s in zip(robots, odometry, turn_rates_rad_s, dts_s, strict=True):
            if dt_s > 0.0:
                before = self._readings[k].copy()
                self._readings[k] += LATEST_SHARE * (motion[:2] - before)
                ways = before, self._readings[k]
                self._predict(self._filters[k], self._values[k], motion, float(turn_rate), float(dt_s), *ways)

    def update(self, robots: Array, poses: Array, information: Array, is_matched: Array, is_clear: Array) -> None:
        """See `CompiledFilters`."""
        for k in robots:
            if not is_matched[k]:
                continue
            ekf, noise = self._filters[k], np.linalg.inv(information[k] + INFORMATION_MIN * np.eye(3))
            part_from_untold(ekf.P, information[k])
            away = _pose_difference(poses[k], ekf.x[:3])
            is_matched[k] = away @ np.linalg.inv(ekf.P[:3, :3] + noise) @ away <= self._gate
            if is_clear[k] and not is_matched[k]:
                ekf.P[:3, :3] += np.outer(away, away)
                is_matched[k] = True
            if is_matched[k]:
                ekf.update(
                    poses[k].copy(),
                    HJacobian=lambda _x: np.eye(3, 5),
                    Hx=lambda x: x[:3],
                    R=noise,
                    residual=_pose_difference,
                )

    def anchor(self, robots: Array, is_new: Array) -> None:
        """See the kernel of this name in `odometry_filter`."""
        for k in robots[is_new[robots]]:
            self._filters[k].P[:3] = self._filters[k].P[:, :3] = 0.0

    def _predict(
        self, ekf, values: Array, odometry: Array, turn_rate_rad_s: float, dt_s: float, before: Array, now: Array
    ) -> None:
        dx, dy, turn_odometry = odometry
        turn = (turn_rate_rad_s - ekf.x[3]) * dt_s
        c, s = math.cos(ekf.x[2]), math.sin(ekf.x[2])
        read_x, read_y = c * dx - s * dy, s * dx + c * dy
        mx, my = (1.0 - ekf.x[4]) * read_x, (1.0 - ekf.x[4]) * read_y
        went_x, went_y = c * before[0] - s * before[1], s * before[0] + c * before[1]
        moved_variance, turn_variance = motion_noise(*now, values)
        ekf.F = np.eye(5)
        ekf.F[:3, 2:] += np.array([[-my, 0.0, -went_x], [mx, 0.0, -went_y], [0.0, -dt_s, 0.0]])
        bias_variance = values[4] ** 2 * dt_s
        ekf.Q = np.diag([moved_variance, moved_variance, turn_variance, bias_variance, 0.0])
        moved = ekf.x + np.array([mx, my, turn, 0.0, 0.0])
        ekf.predict()
        ekf.x = moved  # the motion model is nonlinear, filterpy's predict is linear
        ekf.update(
            np.array([turn_odometry - turn_rate_rad_s * dt_s]),
            HJacobian=lambda _x: np.array([[0.0, 0.0, 0.0, -dt_s, 0.0]]),
            Hx=lambda x: np.array([-x[3] * dt_s]),
            R=np.array([[values[3] ** 2 + values[2] ** 2]]),
        )


def _pose_difference(a: Array, b: Array) -> Array:
    d = a - b
    d[2] = wrap_angle(d[2])
    return d
