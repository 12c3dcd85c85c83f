"""Fuse odometry, gyro and scan matching: an extended Kalman filter over (x, y, heading, gyro bias, odometry's scale).

The scale is what odometry reads too long, as a share. It is learned where scans fix all directions, and carries a robot
through corridors where they do not. How much a step says of it, and how far it may be off, is told by the running mean
of the readings: one that is long by chance would otherwise weigh more, or less, than one that is short, and the scale
be learned wrongly (errors in variables).

The same equations stand in `filterpy_filter`: the oracle that these are tested against, an option of the log tools.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import OdometryFilterConfig
from twc_env.kernels import borrowing_kernel, kernel
from twc_env.slam.small_matrices import invert3

if TYPE_CHECKING:
    from twc_env.slam.filterpy_filter import FilterpyFilters

LATEST_SHARE = 0.2
"""Weight of the latest reading in the mean of the readings before a step."""
INFORMATION_MIN = 1e-6
"""Added to a match's information, so that a direction it does not fix has a variance at all."""
UNTOLD_SHARE = 1e-6
"""A direction that a match leaves open has no information, but for rounding."""


@kernel
def motion_noise(dx, dy, config):
    """Variances of one step's motion: along x and y alike, and of the heading."""
    length = math.sqrt(dx * dx + dy * dy)
    return config[1] ** 2 + config[0] ** 2 * length, config[2] ** 2


@borrowing_kernel
def predict_state(x, p, odometry, turn_rate, dt, config):
    """Move by odometry with the gyro's heading; then learn the gyro's bias from the odometry's turn.

    x (7,) and p (5, 5), see `CompiledFilters`, are changed in place. config: position_std_per_m,
    position_std_m, turn_std_rad, odometry_turn_std_rad, gyro_bias_walk_rad_s, match_gate.
    """
    turn = (turn_rate - x[3]) * dt
    c, s = math.cos(x[2]), math.sin(x[2])  # odometry is given in the robot frame of the last frame
    dx, dy = odometry[0], odometry[1]
    read_x, read_y = c * dx - s * dy, s * dx + c * dy
    mx, my = (1.0 - x[4]) * read_x, (1.0 - x[4]) * read_y
    went_x, went_y = c * x[5] - s * x[6], s * x[5] + c * x[6]
    x[5] += LATEST_SHARE * (dx - x[5])
    x[6] += LATEST_SHARE * (dy - x[6])
    x[0] += mx
    x[1] += my
    x[2] += turn
    moved_variance, turn_variance = motion_noise(x[5], x[6], config)
    # P <- F P F^T with F = I + rows 0-2: d/d heading, d/d scale and d/d bias
    f02, f12, f23 = -my, mx, -dt
    for j in range(5):
        p[0, j] += f02 * p[2, j] - went_x * p[4, j]
        p[1, j] += f12 * p[2, j] - went_y * p[4, j]
        p[2, j] += f23 * p[3, j]
    for i in range(5):
        p[i, 0] += f02 * p[i, 2] - went_x * p[i, 4]
        p[i, 1] += f12 * p[i, 2] - went_y * p[i, 4]
        p[i, 2] += f23 * p[i, 3]
    p[0, 0] += moved_variance
    p[1, 1] += moved_variance
    p[2, 2] += turn_variance
    p[3, 3] += config[4] ** 2 * dt
    # z = odometry turn - gyro turn = -bias dt + noise
    residual = odometry[2] - turn_rate * dt + x[3] * dt
    variance = p[3, 3] * dt * dt + config[3] ** 2 + config[2] ** 2
    bias_x, bias_y, bias_heading, bias, bias_scale = p[3, 0], p[3, 1], p[3, 2], p[3, 3], p[3, 4]
    for i in range(5):
        gain = -p[i, 3] * dt / variance
        x[i] += gain * residual
        p[i, 0] += gain * dt * bias_x
        p[i, 1] += gain * dt * bias_y
        p[i, 2] += gain * dt * bias_heading
        p[i, 3] += gain * dt * bias
        p[i, 4] += gain * dt * bias_scale


@kernel
def update_state(x, p, pose, information, gate):
    """Linear update of x (7,) and p (5, 5) with a measured pose (3,) and its information (3, 3).

    Gives whether it was done: a pose that is further from the prediction than `gate` (squared, by the covariance of
    their difference) changes nothing.
    """
    work = np.empty((5, 5, 5))
    r, s, inverse, gain, old = work[0], work[1], work[2], work[3], work[4]
    for i in range(5):
        for j in range(5):
            old[i, j] = p[i, j]
    for i in range(3):
        for j in range(3):
            s[i, j] = information[i, j]
        s[i, i] += INFORMATION_MIN
    invert3(s, r)
    for i in range(3):
        for j in range(3):
            s[i, j] = p[i, j] + r[i, j]
    invert3(s, inverse)
    ahead, left = pose[0] - x[0], pose[1] - x[1]
    turned = (pose[2] - x[2] + math.pi) % (2 * math.pi) - math.pi
    squared = ahead * (inverse[0, 0] * ahead + 2 * (inverse[0, 1] * left + inverse[0, 2] * turned))
    squared += left * (inverse[1, 1] * left + 2 * inverse[1, 2] * turned) + inverse[2, 2] * turned * turned
    if squared > gate:
        return False
    for i in range(5):
        for j in range(3):
            gain[i, j] = old[i, 0] * inverse[0, j] + old[i, 1] * inverse[1, j] + old[i, 2] * inverse[2, j]
    for i in range(5):
        x[i] += gain[i, 0] * ahead + gain[i, 1] * left + gain[i, 2] * turned
        for j in range(i, 5):
            p[i, j] = old[i, j] - gain[i, 0] * old[0, j] - gain[i, 1] * old[1, j] - gain[i, 2] * old[2, j]
            p[j, i] = p[i, j]
    return True


@kernel
def open_direction(information):
    """Whether a match leaves a direction of the place open, as a corridor its axis, and that direction, of length 1."""
    a, b, d = information[0, 0], information[0, 1], information[1, 1]
    mean, half = 0.5 * (a + d), 0.5 * math.sqrt((a - d) ** 2 + 4.0 * b * b)
    if not (mean > 0.0 and mean - half <= UNTOLD_SHARE * mean):
        return False, 0.0, 0.0
    angle = 0.5 * math.atan2(2.0 * b, a - d) + 0.5 * math.pi
    return True, math.cos(angle), math.sin(angle)


@kernel
def part_from_untold(p, information):
    """Where a match leaves a direction open, nothing else is told by how far the robot has come along it.

    Walls that fix it again further on stand where the robot believes that it is. They would seem to confirm all that it
    went by to get there, odometry's scale above all. Changes p (5, 5) in place.
    """
    is_open, ahead, left = open_direction(information)
    if not is_open:
        return
    along = ahead, left
    others = np.empty(5)
    for j in range(5):
        others[j] = along[0] * p[0, j] + along[1] * p[1, j]
    variance = along[0] * others[0] + along[1] * others[1]
    for axis in range(2):
        others[axis] -= variance * along[axis]
    for axis in range(2):
        for j in range(5):
            p[axis, j] -= along[axis] * others[j]
    for j in range(5):
        for axis in range(2):
            p[j, axis] -= along[axis] * others[j]


@kernel
def believe_match(x, p, pose, information, gate, is_clear):
    """`update_state`; and a pose that contradicts the prediction is believed where it `is_clear`: the robot slipped.

    What was slipped is then as unknown as it is long. Gives whether the pose is believed.
    """
    part_from_untold(p, information)
    if update_state(x, p, pose, information, gate):
        return True
    if not is_clear:
        return False
    turned = (pose[2] - x[2] + math.pi) % (2 * math.pi) - math.pi
    slipped = pose[0] - x[0], pose[1] - x[1], turned
    for i in range(3):
        for j in range(3):
            p[i, j] += slipped[i] * slipped[j]
    return update_state(x, p, pose, information, gate)


def process_values(config: OdometryFilterConfig) -> Array:
    """(6,) what `predict_state` and `update_state` take from the settings."""
    return np.array(
        [
            config.position_std_per_m,
            config.position_std_m,
            config.turn_std_rad,
            config.odometry_turn_std_rad,
            config.gyro_bias_walk_rad_s,
            config.match_gate,
        ]
    )


@kernel
def motion_covariance(variance, heading, matched, std_min, out):
    """Write the covariance (3, 3) of the motion since the last keyframe to a pose with this heading, in its own frame.

    variance (3,): odometry's, gathered on the way; matched (3, 3): information of the pose now, in the odom frame
    (zeros when nothing was matched); std_min (3,): nothing is known better than this.
    """
    c, s = math.cos(heading), math.sin(heading)
    information, turned = np.zeros((3, 3)), np.empty((3, 3))
    for i in range(3):  # turned = matched @ R, information = R^T turned
        turned[i, 0] = matched[i, 0] * c + matched[i, 1] * s
        turned[i, 1] = matched[i, 1] * c - matched[i, 0] * s
        turned[i, 2] = matched[i, 2]
    for j in range(3):
        information[0, j] = c * turned[0, j] + s * turned[1, j]
        information[1, j] = c * turned[1, j] - s * turned[0, j]
        information[2, j] = turned[2, j]
        information[j, j] += 1.0 / max(variance[j], 1e-9)
    invert3(information, out)
    for j in range(3):
        out[j, j] += std_min[j] ** 2


@borrowing_kernel
def _predict_all(states, covariances, robots, odometry, turn_rates, dts, config):
    for a in range(robots.shape[0]):
        k = robots[a]
        if dts[a] > 0.0:
            predict_state(states[k], covariances[k], odometry[a], turn_rates[a], dts[a], config)


@kernel
def _update_all(states, covariances, robots, poses, information, is_matched, is_clear, gate):
    for a in range(robots.shape[0]):
        k = robots[a]
        if is_matched[k]:
            is_matched[k] = believe_match(states[k], covariances[k], poses[k], information[k], gate, is_clear[k])


@borrowing_kernel
def anchor(covariances, robots, is_new):
    """Whoever of these robots (k,) `is_new` (n,) stands, from now on, where it is by definition.

    Where nothing but odometry tells of poses, what is learned later of the gyro's bias would move all of the way gone:
    a motion between two places would take in what the whole way before them was off.
    """
    for k in robots:
        if is_new[k]:
            for axis in range(3):
                for j in range(5):
                    covariances[k, axis, j] = covariances[k, j, axis] = 0.0


def first_covariance(config: OdometryFilterConfig) -> Array:
    """(5, 5) before a robot has moved."""
    return np.diag([1e-6, 1e-6, 1e-8, config.gyro_bias_std_rad_s**2, config.odometry_scale_std**2])


class CompiledFilters:
    """One filter per robot, all in one compiled call: those of the hot path."""

    believes_scans = True

    def __init__(self, config: OdometryFilterConfig, count: int):
        self.noise = process_values(config)
        self.states = np.zeros((count, 7))
        """(n, 7) x [m], y [m], heading [rad], gyro bias [rad/s] in its odom frame, by what share odometry reads too
        long, and the running mean of how far it reads ahead and to the left [m]; the heading is not wrapped."""
        self.covariances = np.tile(first_covariance(config), (count, 1, 1))
        """(n, 5, 5)."""

    def predict(self, robots: Array, odometry: Array, turn_rates_rad_s: Array, dts_s: Array) -> None:
        """Move these robots (k,) by one frame: odometry (k, 3), gyro (k,) and time since the last one (k,).

        Where no time has passed nothing moves.
        """
        _predict_all(self.states, self.covariances, robots, odometry, turn_rates_rad_s, dts_s, self.noise)

    def update(self, robots: Array, poses: Array, information: Array, is_matched: Array, is_clear: Array) -> None:
        """Correct these robots (k,) where they were matched (n,).

        poses (n, 3) measured by scan matching, their information (n, 3, 3) may be singular. Who was not corrected,
        since the match contradicts the prediction and is not a clear one (n,), is marked as not matched.
        """
        _update_all(self.states, self.covariances, robots, poses, information, is_matched, is_clear, self.noise[5])

    def anchor(self, robots: Array, is_new: Array) -> None:
        """See the kernel of this name."""
        anchor(self.covariances, robots, is_new)


class OdometryAlone(CompiledFilters):
    """Believes odometry as it is; for perfect odometry (`slam.oracle`)."""

    believes_scans = False

    def update(self, robots: Array, poses: Array, information: Array, is_matched: Array, is_clear: Array) -> None:
        """What scans say is left out."""


def make_filters(
    config: OdometryFilterConfig, count: int, believes_scans: bool = True
) -> CompiledFilters | FilterpyFilters:
    """One filter per robot, of the kind that `config.backend` names."""
    if not believes_scans:
        return OdometryAlone(config, count)
    if config.backend == "filterpy":
        from twc_env.slam.filterpy_filter import FilterpyFilters

        return FilterpyFilters(config, count)
    return CompiledFilters(config, count)
