"""The robots' front ends: sensor frames in, a smooth pose estimate and keyframes out.

What every step costs is computed for all robots at once, over common arrays; what a keyframe costs, robot by robot.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.messages import Keyframe, SensorFrame, SignObservation, SignReading
from twc_env.slam.keyframe_taking import KeyframeTaker
from twc_env.slam.scan_matching import LineField
from twc_env.slam.tracking import Tracker
from twc_env.team_messages import TeamFrames

REDRAW_SPACING_M = 0.9
"""When the local map moves on, of the older keyframes every one this far along the path is drawn again."""
READINGS_MAX = 256
"""Of what a robot reads between two keyframes the latest are kept: one that waits before a door reads it all day."""


class FrontEnds:
    """Odometry, gyro and scan matching against a local map, each robot in its own odom frame (it starts at 0, 0, 0).

    No robot's estimate depends on another's.
    """

    def __init__(self, config: EnvConfig, count: int):
        self._tracker = Tracker(config, count)
        self.poses_odom = self._tracker.poses_odom
        """(n, 3) the estimates after the latest frames; another array after every update."""
        self._taker = KeyframeTaker(config, self._tracker)
        self.everyone = np.arange(count)
        """(n,) the numbers of all robots."""
        self.robots = [RobotFrontEnd(config, field) for field in self._tracker.fields.each]
        """What each robot remembers for itself."""

    def update(self, frames: Sequence[SensorFrame], team_step: int = -1) -> list[Keyframe]:
        """Take in at most one frame per robot; gives a keyframe of each that came to a new place.

        team_step: the engine's step, see `Keyframe`.
        """
        if isinstance(frames, TeamFrames):
            return self.update_together(frames, team_step)
        together: dict[tuple[int, float], list[SensorFrame]] = {}
        for frame in frames:  # of robots whose clocks may differ, as in recordings
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
                if signs:
                    self.robots[k].read_signs(signs, tracker.poses_odom[k])
        if not tracker.has_arrived:
            return []
        is_new = tracker.is_new
        return [self._take_keyframe(k, (frames.step, team_step), frames.time_s) for k in robots.tolist() if is_new[k]]

    def _take_keyframe(self, k: int, steps: tuple[int, int], time_s: float) -> Keyframe:
        robot = self.robots[k]
        signs = robot.signs_seen_from(self._tracker.poses_odom[k])
        keyframe, is_drawn = self._taker.take(k, robot.taken, steps, time_s, signs)
        robot.remember(keyframe)
        if not is_drawn:
            self._taker.centres_m[k] = keyframe.pose_odom[:2]
            robot.move_on()
        return keyframe


class RobotFrontEnd:
    """What one robot remembers: its latest keyframes, its local map, and what it read since the last keyframe."""

    def __init__(self, config: EnvConfig, field: LineField):
        """field: of its local map."""
        self._field, self._memory_m = field, config.slam.local_map.memory_m
        self.taken = 0
        """How many keyframes the robot has taken."""
        self._recent: list[Keyframe] = []
        """Those that may still be drawn into the local map, and the latest one."""
        self._readings: deque[tuple[str, float, float, float]] = deque(maxlen=READINGS_MAX)
        """Text, place [m, m] and facing [rad] in the odom frame of each sign read since the last keyframe."""

    def read_signs(self, signs: Sequence[SignReading], pose_odom: Array) -> None:
        """Note the signs of a frame with the walls they hang on."""
        x, y, heading = pose_odom.tolist()
        for sign in signs:
            angle = heading + sign.bearing_rad
            place = x + sign.range_m * math.cos(angle), y + sign.range_m * math.sin(angle)
            self._readings.append((sign.text, *place, self._field.facing_at(place, (x, y))))

    def signs_seen_from(self, pose_odom: Array) -> tuple[SignObservation, ...]:
        """The signs read since the last keyframe, in the frame of the next one, which is taken at this pose."""
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

    def remember(self, keyframe: Keyframe) -> None:
        """The robot has taken a keyframe."""
        self.taken += 1
        self._recent.append(keyframe)

    def move_on(self) -> None:
        """Put the latest keyframe into the middle of the local map, and draw what was seen around it.

        Raises DataError for numbers that are not sound.
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
