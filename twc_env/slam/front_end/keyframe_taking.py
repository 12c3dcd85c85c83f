"""Creation of a keyframe from a robot's tracked state, and its drawing into the local map, in one compiled call."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twc_env.config import EnvConfig, robot_configs
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import Keyframe, SignObservation
from twc_env.slam.front_end.tracking import Tracker
from twc_env.slam.odometry.odometry_filter import motion_covariance
from twc_env.slam.places.radio_fingerprint import STD_MODES, fingerprint_of
from twc_env.slam.scans.teammate_detection import MEMORY, unmark
from twc_env.slam.scans.wall_cells import LINES_MAX
from twc_env.slam.scans.wall_drawing import LINES, draw_scan, drawing_room

MOTION_STD_MIN = (0.013, 0.013, 0.004)
"""Least standard deviation of the motion between two keyframes [m, m, rad]."""


@kernel
def _measure_motion(last, pose, steps, length, variances, matched, motion, covariance):
    """Write the motion (3,) from the last keyframe's pose to a pose, and its covariance (3, 3) in the pose's frame.

    Odometry variances grow with steps and path length. The information of the last match is counted half.
    """
    c, s = math.cos(last[2]), math.sin(last[2])
    dx, dy = pose[0] - last[0], pose[1] - last[1]
    motion[0], motion[1] = c * dx + s * dy, c * dy - s * dx
    motion[2] = (pose[2] - last[2] + math.pi) % (2 * math.pi) - math.pi
    moved = steps * variances[0] + length * variances[1]
    motion_covariance((moved, moved, steps * variances[2]), pose[2], 0.5 * matched, MOTION_STD_MIN, covariance)


@borrowing_kernel
def _take(apparatus, k, time, poses, rings, scan, pose, motion, covariance):
    """Fill the arrays of a keyframe of robot k: scan (beams,), pose (3,), motion and its covariance; draw the scan.

    Returns the number of transmitters in the fingerprint, the path length, and whether the scan was drawn into the
    local map. It is not if the robot has left the map's centre, if the map is full or if values are not finite.
    """
    (
        marked, discs, disc_counts, seen, following, travels, steps, information, last_poses, last_travels, variances,
        window, std_mode, cells, lines, origins, drawn, centres, reach, inverse_m, range_max,
        directions, room,
    ) = parts_of(apparatus)  # fmt: skip
    here = poses[k]
    for i in range(scan.shape[0]):
        scan[i] = marked[k, i]
    if disc_counts[k] > 0:
        following[k] = unmark(scan, discs[k, : disc_counts[k]], here, seen[k], following[k], travels[k], time)
    if math.isnan(last_poses[k, 0]):
        motion[:] = 0.0
        covariance[:] = 0.0
    else:
        length = travels[k] - last_travels[k]
        _measure_motion(last_poses[k], here, steps[k], length, variances[k], information[k], motion, covariance)
    for axis in range(3):
        pose[axis] = last_poses[k, axis] = here[axis]
    last_travels[k], steps[k] = travels[k], 0
    heard = fingerprint_of(k, rings, time - window[0], window[1], window[2], std_mode)
    dx, dy = here[0] - centres[k, 0], here[1] - centres[k, 1]
    has_room = drawn[k, LINES] + scan.shape[0] <= LINES_MAX
    is_drawn = (
        math.hypot(dx, dy) <= reach
        and has_room
        and draw_scan(cells[k], lines[k], origins[k], inverse_m, pose, directions, scan, range_max, room, drawn[k])
    )
    return heard, travels[k], is_drawn


class KeyframeTaker(BindsAnew):
    """Creates the keyframes of all robots from the tracker's poses, scans and recent WiFi readings."""

    def __init__(self, config: EnvConfig, tracker: Tracker):
        self._tracker, self._beams = tracker, config.lidar.circle_beam_count
        count, rule = len(tracker.poses_odom), config.slam.keyframe
        self._discs_seen, self._following = np.full((count, MEMORY, 4), np.inf), np.zeros(count, np.int64)
        """Memory of static discs of each robot, see `unmark`."""
        self._last_travels_m = np.zeros(count)
        self.centres_m = np.zeros((count, 2))
        """(robots, 2) centre of each robot's local map."""
        self._reach_m = max(0.5 * config.slam.local_map.size_m - config.lidar.range_max_m - 1.0, 1.0)
        assumed = [own.slam.odometry_filter for own in robot_configs(config)] if config.robot else None
        noises = assumed or [config.slam.odometry_filter] * count
        self._variances = np.square([[n.position_std_m, n.position_std_per_m, n.turn_std_rad] for n in noises])
        """(robots, 3) odometry variances: position per step [m2], position per metre [m2], turn per step [rad2]."""
        self._window = np.array([rule.fingerprint_window_s, rule.fingerprint_age_max_s, rule.fingerprint_detection_min])
        self._std_mode = STD_MODES[rule.std_mode]
        self._run: Callable[..., tuple[int, float, bool]] | None = None
        """`_take`, bound to its constant arguments."""

    def take(
        self, robot: int, index: int, steps: tuple[int, int], time_s: float, signs: tuple[SignObservation, ...]
    ) -> tuple[Keyframe, bool]:
        """The robot's keyframe with this index, and whether it was drawn; if not, the local map must be moved first.

        steps: the robot's own step number and the engine's.
        """
        tracker = self._tracker
        scan, pose, motion, covariance = np.empty(self._beams), np.empty(3), np.empty(3), np.empty((3, 3))
        now = robot, time_s, tracker.poses_odom, tracker.radio.rings, scan, pose, motion, covariance
        if self._run is None:
            self._run = bound(_take, self._packed(), *now)
        heard, travel_m, is_drawn = self._run(*now)
        fingerprint, alone = tracker.radio.latest(heard), tracker.take_by_odometry(robot)
        keyframe = Keyframe(
            robot, index, steps[0], time_s, pose, motion, covariance, travel_m, scan, signs, fingerprint, steps[1],
            *alone,
        )  # fmt: skip
        return keyframe, is_drawn

    def begin_segment(self, robot: int) -> None:
        """Forget what this robot sensed at the place from which it was carried off."""
        self._discs_seen[robot] = np.inf
        self._tracker.radio.clear(robot)
        self.centres_m[robot] = self._tracker.poses_odom[robot, :2]

    def _packed(self) -> Lent:
        """The constant arguments of `_take`."""
        tracker, fields = self._tracker, self._tracker.fields
        beams = tracker.marked_m.shape[1]
        parts = (
            tracker.marked_m, tracker.discs, tracker.disc_counts, self._discs_seen, self._following,
            tracker.travels_m, tracker.steps, tracker.information, tracker.keyframe_poses, self._last_travels_m,
            self._variances, self._window, self._std_mode, fields.cells, fields.lines, fields.origins_m,
            fields.drawn, self.centres_m, self._reach_m, fields.inverse_m, fields.range_max_m,
            beam_directions(beams), drawing_room(beams, fields.range_noise),
        )  # fmt: skip
        return Lent(parts)
