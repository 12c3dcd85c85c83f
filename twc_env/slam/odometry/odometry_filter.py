"""Extended Kalman filter that fuses odometry, gyro and scan matching: x, y, heading, gyro bias, odometry scale error.

The scale error is the share by which odometry reads too long. It is learned where scan matching constrains all
directions and used in corridors where it does not. Its Jacobian and the motion noise use a running mean of the
readings: with the reading itself, a step that is long by chance would get another weight than a short one, which biases
the scale (errors in variables).

`filterpy_filter` has the same equations: the reference in tests, and an option of the log tools.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import OdometryFilterConfig
from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.kernels.small_matrices import invert3

LATEST_SHARE = 0.2
"""Weight of the latest reading in the running mean of readings."""
INFORMATION_MIN = 1e-6
"""Added to a match's information, so that it is invertible in unconstrained directions."""
UNTOLD_SHARE = 1e-6
"""Eigenvalue ratio below which a direction counts as unconstrained (rounding errors)."""


@kernel
def motion_noise(dx, dy, config):
    """Variance of one step's motion along x and y (equal) [m^2] and of its heading [rad^2]."""
    length = math.sqrt(dx * dx + dy * dy)
    return config[1] ** 2 + config[0] ** 2 * length, config[2] ** 2


@borrowing_kernel
def predict_state(x, p, odometry, turn_rate, dt, config):
    """Predict with odometry and the gyro's heading; then update the gyro bias with the odometry's turn.

    x (7,) and p (5, 5), see `CompiledFilters`, are changed in place. config: position_std_per_m, position_std_m,
    turn_std_rad, odometry_turn_std_rad, gyro_bias_walk_rad_s, match_gate.
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

    Returns False and changes nothing if the squared Mahalanobis distance of the innovation exceeds `gate`.
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
    """Whether the information (3, 3) leaves a direction of the position unconstrained (a corridor's axis), and its unit
    vector."""
    a, b, d = information[0, 0], information[0, 1], information[1, 1]
    mean, half = 0.5 * (a + d), 0.5 * math.sqrt((a - d) ** 2 + 4.0 * b * b)
    if not (mean > 0.0 and mean - half <= UNTOLD_SHARE * mean):
        return False, 0.0, 0.0
    angle = 0.5 * math.atan2(2.0 * b, a - d) + 0.5 * math.pi
    return True, math.cos(angle), math.sin(angle)


@kernel
def part_from_untold(p, information):
    """Remove the correlation of the unconstrained direction of a match with the rest of the state, in place in p (5,
    5).

    Walls that constrain that direction later are mapped at the believed position. A match with them would seem to
    confirm everything used to get there, above all the odometry scale.
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
    """`update_state`; an innovation beyond the gate is still used where the match `is_clear`: the robot slipped.

    The covariance is then inflated by the outer product of the slip. Returns whether the match was used.
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
    """(6,) parameters of `predict_state` and `update_state` from the config."""
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
    """Write to `out` (3, 3) the covariance of the motion since the last keyframe, in the frame of the pose with this
    heading.

    variance (3,): accumulated odometry noise; matched (3, 3): information of the current pose in the odom frame (zeros
    if not matched); std_min (3,): lower bound.
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
def _predict_all(states, covariances, robots, odometry, turn_rates, dts, noise):
    for a in range(robots.shape[0]):
        k = robots[a]
        if dts[a] > 0.0:
            predict_state(states[k], covariances[k], odometry[a], turn_rates[a], dts[a], noise[k])


@kernel
def _update_all(states, covariances, robots, poses, information, is_matched, is_clear, noise):
    for a in range(robots.shape[0]):
        k = robots[a]
        if is_matched[k]:
            is_matched[k] = believe_match(states[k], covariances[k], poses[k], information[k], noise[k, 5], is_clear[k])


@borrowing_kernel
def anchor(covariances, robots, is_new):
    """Fix the current pose of those robots (k,) that have a new keyframe (`is_new` (n,)): zero its covariance.

    Without scan matching, a later correction of the gyro bias would otherwise move the whole past path, and the motion
    between two keyframes would include the error of the way before them.
    """
    for k in robots:
        if is_new[k]:
            for axis in range(3):
                for j in range(5):
                    covariances[k, axis, j] = covariances[k, j, axis] = 0.0


def first_covariance(config: OdometryFilterConfig) -> Array:
    """(5, 5) initial covariance."""
    return np.diag([1e-6, 1e-6, 1e-8, config.gyro_bias_std_rad_s**2, config.odometry_scale_std**2])


class CompiledFilters:
    """One filter per robot, all updated in one compiled call."""

    believes_scans = True

    def __init__(self, config: OdometryFilterConfig | Sequence[OdometryFilterConfig], count: int):
        """config: assumptions of all robots, or of each."""
        own = [config] * count if isinstance(config, OdometryFilterConfig) else config
        self.noise = np.array([process_values(each) for each in own])
        """(n, 6) see `process_values`."""
        self.states = np.zeros((count, 7))
        """(n, 7) x [m], y [m], heading [rad] (not wrapped), gyro bias [rad/s] in the odom frame, odometry scale error
        (share), and the running mean of the forward and left readings [m]."""
        self.covariances = np.array([first_covariance(each) for each in own])
        """(n, 5, 5)."""

    def predict(self, robots: Array, odometry: Array, turn_rates_rad_s: Array, dts_s: Array) -> None:
        """Predict robots (k,) by one frame: odometry (k, 3), gyro (k,) and time since the last frame (k,); no-op at
        zero time."""
        _predict_all(self.states, self.covariances, robots, odometry, turn_rates_rad_s, dts_s, self.noise)

    def update(self, robots: Array, poses: Array, information: Array, is_matched: Array, is_clear: Array) -> None:
        """Update the robots (k,) that are matched (n,).

        poses (n, 3) by scan matching with information (n, 3, 3), which may be singular. is_matched is cleared for
        robots whose match exceeds the gate and is not clear (n,).
        """
        _update_all(self.states, self.covariances, robots, poses, information, is_matched, is_clear, self.noise)

    def anchor(self, robots: Array, is_new: Array) -> None:
        """See the kernel of this name."""
        anchor(self.covariances, robots, is_new)


class OdometryAlone(CompiledFilters):
    """Ignores scan matches; for perfect odometry (`slam.oracle`)."""

    believes_scans = False

    def update(self, robots: Array, poses: Array, information: Array, is_matched: Array, is_clear: Array) -> None:
        """Does nothing."""
