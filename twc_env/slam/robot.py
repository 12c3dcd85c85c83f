"""The robots' front ends. Input: sensor frames; output: a smooth pose estimate and keyframes.

Work of every step is done for all robots at once on common arrays; work per keyframe robot by robot.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.records.messages import Keyframe, SensorFrame, SignObservation, SignReading
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.front_end.keyframe_taking import KeyframeTaker
from twc_env.slam.front_end.scan_intake import ScanIntake
from twc_env.slam.front_end.tracking import Tracker
from twc_env.slam.matching.scan_matching import LineField

REDRAW_SPACING_M = 0.9
"""When the local map is re-centred, older keyframes are redrawn at this path spacing."""
READINGS_MAX = 256
"""Maximum sign readings between two keyframes (latest kept); a robot waiting before a door reads it continuously."""


class FrontEnds:
    """Odometry, gyro and scan matching against a local map, each robot in its own odom frame (start at 0, 0, 0).

    The robots' estimates are independent of each other.
    """

    def __init__(self, config: EnvConfig, count: int):
        self.intake = ScanIntake(config, count)
        """Makes the scans of the frames given to the engine those that the front ends take."""
        self._tracker = Tracker(config, count, self.intake)
        self.poses_odom = self._tracker.poses_odom
        """(n, 3) estimates after the latest frames; a new array after every update."""
        self._taker = KeyframeTaker(config, self._tracker)
        self.everyone = np.arange(count)
        """(n,) indices of all robots."""
        self.robots = [RobotFrontEnd(config, field) for field in self._tracker.fields.each]
        """Per-robot state."""

    @property
    def information(self) -> Array:
        """(n, 3, 3) information of the latest matches; zeros if not matched."""
        return self._tracker.information

    def update(self, frames: Sequence[SensorFrame], team_step: int = -1) -> list[Keyframe]:
        """Take in at most one frame per robot; gives a keyframe of each that came to a new place.

        team_step: the engine's step, see `Keyframe`.
        """
        if isinstance(frames, TeamFrames):
            return self.update_together(frames, team_step)
        together: dict[tuple[int, float], list[SensorFrame]] = {}
        for frame in frames:  # clocks may differ between robots, as in recordings
            together.setdefault((frame.step, frame.time_s), []).append(frame)
        keyframes = []
        for some in together.values():
            keyframes += self.update_together(TeamFrames.of(some), team_step, np.array([frame.robot for frame in some]))
        return keyframes

    def update_together(self, frames: TeamFrames, team_step: int = -1, robots: Array | None = None) -> list[Keyframe]:
        """The same for frames of one time; robots (k,): whose they are, None for everyone's."""
        tracker, robots = self._tracker, self.everyone if robots is None else robots
        tracker.update(robots, frames)
        self.poses_odom = tracker.poses_odom
        if any(frames.signs):
            for k, signs in zip(robots.tolist(), frames.signs, strict=True):
                if signs and not tracker.is_carried[k]:
                    self.robots[k].read_signs(signs, tracker.poses_odom[k])
        if not tracker.has_arrived:
            return []
        is_new = tracker.is_new
        return [self._take_keyframe(k, (frames.step, team_step), frames.time_s) for k in robots.tolist() if is_new[k]]

    def _take_keyframe(self, k: int, steps: tuple[int, int], time_s: float) -> Keyframe:
        robot, is_carried = self.robots[k], bool(self._tracker.is_carried[k])
        if is_carried:
            self._taker.begin_segment(k)
            robot.begin_segment(self._tracker.poses_odom[k])
        signs = robot.signs_seen_from(self._tracker.poses_odom[k])
        keyframe, is_drawn = self._taker.take(k, robot.taken, steps, time_s, signs)
        if is_carried:
            keyframe = replace(keyframe, begins_segment=True)
        robot.remember(keyframe)
        if not is_drawn:
            self._taker.centres_m[k] = keyframe.pose_odom[:2]
            robot.move_on()
        return keyframe


class RobotFrontEnd:
    """State of one robot: recent keyframes, local map, and sign readings since the last keyframe."""

    def __init__(self, config: EnvConfig, field: LineField):
        """field: line field of its local map."""
        self._field, self._memory_m = field, config.slam.local_map.memory_m
        self._facing_of = field.facing_at if config.slam.cues.lidar else field.facing_around
        self.taken = 0
        """Number of keyframes taken."""
        self._recent: list[Keyframe] = []
        """Keyframes that may be redrawn into the local map, and the latest one."""
        self._readings: deque[tuple[str, float, float, float]] = deque(maxlen=READINGS_MAX)
        """Text, position [m, m] and facing [rad] in the odom frame of each sign read since the last keyframe."""

    def read_signs(self, signs: Sequence[SignReading], pose_odom: Array) -> None:
        """Store the sign readings of a frame with the facing of the wall behind each."""
        x, y, heading = pose_odom.tolist()
        for sign in signs:
            angle = heading + sign.bearing_rad
            place = x + sign.range_m * math.cos(angle), y + sign.range_m * math.sin(angle)
            self._readings.append((sign.text, *place, self._facing_of(place, (x, y))))

    def signs_seen_from(self, pose_odom: Array) -> tuple[SignObservation, ...]:
        """The signs read since the last keyframe, in the frame of the next keyframe at this pose; clears them."""
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
        self._readings.clear()
        return signs

    def begin_segment(self, pose_odom: Array) -> None:
        """Begin a new local map at a pose (3,), where the robot was put down."""
        self._field.reset(pose_odom[:2])
        self._recent.clear()
        self._readings.clear()

    def remember(self, keyframe: Keyframe) -> None:
        """Record a new keyframe."""
        self.taken += 1
        self._recent.append(keyframe)

    def move_on(self) -> None:
        """Re-centre the local map at the latest keyframe and redraw the recent keyframes around it.

        Raises DataError for values that are not finite.
        """
        latest = self._recent[-1]
        self._field.reset(latest.pose_odom[:2])
        horizon = latest.travel_m - self._memory_m
        self._recent = [old for old in self._recent if old.travel_m >= horizon]
        drawn = [latest]
        for old in reversed(self._recent[:-1]):
            if drawn[-1].travel_m - old.travel_m >= REDRAW_SPACING_M:
                drawn.append(old)
        self._field.add(np.array([k.pose_odom for k in drawn]), np.array([k.ranges_m for k in drawn]))
