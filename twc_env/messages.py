"""The records that cross borders between packages. None of them can hold a true pose.

Frames: `robot` is the body frame (x ahead, y left); `odom` is where one robot's front end started (continuous, drifts);
`map` is the frame of the merged map of the robot's group (jumps when closures arrive). `pose_map_robot` is the pose of
the robot in the map frame, as (x [m], y [m], heading [rad]).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray as Array

_Record = TypeVar("_Record")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def _record(kind: type[_Record]) -> type[_Record]:
    """A record that type checkers take as frozen. It is made all the time: freezing it would triple its cost."""
    return dataclass(slots=True, eq=False)(kind)


UNSEEN_M = -0.001
"""Range of a beam that tells nothing, as behind a scanner that looks ahead only: free up to nowhere, and no wall."""


@_record
class WifiScan:
    """One sweep over the radio channels: the transmitters heard and how strongly."""

    macs: Array
    """(heard,) int64, ascending: the 48-bit MAC addresses heard; LTE cells have numbers of 2^48 and above."""
    rssi_dbm: Array
    """(heard,) float64, received strength of each."""
    age_s: Array | None = None
    """(heard,) float64, how long ago each was really heard; None: all in this sweep."""


@dataclass(frozen=True, slots=True)
class SignReading:
    """One text read by the camera, as the OCR gave it (so possibly misread)."""

    text: str
    bearing_rad: float
    """Direction of the sign's centre in the robot frame."""
    range_m: float
    """Measured distance to the sign's centre."""


@_record
class SensorFrame:
    """All that one robot measures in one step. The engine knows nothing else of the world."""

    robot: int
    step: int
    time_s: float
    """By the robot's own clock, which may count from anywhere and jump ahead, but not back."""
    odometry: Array
    """(3,) motion since the last frame in the robot frame of that frame [m, m, rad], from wheels, legs or hand."""
    turn_rate_rad_s: float
    """Gyro: turn rate averaged over the time since the last frame."""
    ranges_m: Array
    """(beams,) beam i points to 2 pi i / beams in the robot frame; no return reads the scanner's maximum range.

    A negative range is free up to there without a wall; `UNSEEN_M` says nothing at all, and 0 is refused."""
    wifi: WifiScan | None = None
    """The scan that finished in this step, if one did."""
    signs: tuple[SignReading, ...] = ()


@_record
class Fingerprint:
    """The radio signature of a place: clipped mean strength of each transmitter (TWC-SLAM Eq. 7-8)."""

    macs: Array
    """(heard,) int64, ascending."""
    rssi_dbm: Array
    """(heard,) float64."""


@_record
class SignObservation:
    """A text that was read near a keyframe, placed in the keyframe's robot frame."""

    text: str
    position_m: Array
    """(2,)."""
    facing_rad: float
    """Outward normal of the wall it hangs on, as the local map shows it; NaN where the map shows no wall."""


@_record
class Keyframe:
    """A place a robot remembers: where its front end believed it was, and what it sensed there."""

    robot: int
    index: int
    """Counts the robot's own keyframes from 0."""
    step: int
    time_s: float
    """Since the robot's first frame."""
    pose_odom: Array
    """(3,) pose in the robot's odom frame."""
    motion: Array
    """(3,) pose in the frame of the previous keyframe (zeros for the first)."""
    motion_covariance: Array
    """(3, 3) covariance of `motion` [m2, m rad, rad2], along the axes of this keyframe's own frame."""
    travel_m: float
    """Path length up to here."""
    ranges_m: Array
    """(beams,) the scan taken here; negative where the beam met a team mate: free up to there, but no wall."""
    signs: tuple[SignObservation, ...]
    """Texts read since the last keyframe."""
    fingerprint: Fingerprint
    by_odometry_m: tuple[float, float] = (0.0, 0.0)
    """What of `motion` matched scans leave open, as along a corridor, by the axes of this keyframe."""
    odometry_scale: tuple[float, float] = (0.0, 0.0)
    """By what share the robot takes its odometry to read too long, one sigma; zeros while scans left nothing open."""

    @property
    def key(self) -> tuple[int, int]:
        """(robot, index), by which closures and messages name it."""
        return self.robot, self.index


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Who reached whom over the radio in one step. Rows listen: all robots, or the one mapper; columns send: robots."""

    tried: Array
    """(listeners, robots) bool: near enough, so that what there was to say was sent."""
    heard: Array
    """(listeners, robots) bool: and it was not lost."""


@_record
class LoopCandidate:
    """A pair of keyframes that look like one place, not yet checked by geometry."""

    target: tuple[int, int]
    """(robot, keyframe index)."""
    source: tuple[int, int]
    guess: Array
    """(3,) first guess of the source's pose in the target's frame."""
    recogniser: str
    """Who proposed it: "twc", "text", "wifi", "lidar", "fused", "meeting" (by WiFi, of robots that share no map), or
    "proximity" (near in the present estimate)."""
    sign_m: Array | None = None
    """(2,) the sign that both saw, in the target's frame; None when no sign is meant."""
    text_similarity: float = float("nan")
    mac_similarity: float = float("nan")
    rssi_similarity: float = float("nan")
    log_odds: float = float("nan")
    """Of `fused`: how sure it is that this is one place."""

    @property
    def is_read_alike(self) -> bool:
        """Whether nothing sets the two texts apart: they agree to the letter, or likeness of texts was not asked."""
        return not self.text_similarity < 1.0


LOOSE_M = 0.5
"""A closure that may err by more (one sigma) leaves a direction open."""


def is_loose(covariance: Array) -> bool:
    """Whether a closure with this covariance (3, 3) leaves a direction open."""
    return bool(covariance[0, 0] + covariance[1, 1] > LOOSE_M**2)


@dataclass(slots=True, eq=False)
class LoopClosure:
    """A candidate after scan matching, and what the back end thinks of it now."""

    candidate: LoopCandidate
    pose_target_source: Array
    """(3,) measured pose of the source in the target's frame."""
    covariance: Array
    """(3, 3) of the measurement, along the axes of the source's frame, as pose graphs in g2o files have it."""
    overlap: float
    """Share of the source's points that lie on the target's walls."""
    status: str
    """"accepted", "pending" (waits for other closures that agree) or "rejected"."""
    reason: str = ""
    """Why it is not accepted."""
    number: int = -1
    """Its place among the closures of the mapper that verified it."""

    @property
    def is_loose(self) -> bool:
        """Whether it leaves a direction open: along a bare corridor scans fit everywhere."""
        return is_loose(self.covariance)

    def joins(self, a: Collection[int], b: Collection[int]) -> bool:
        """Whether one end is a keyframe of robots `a` and the other of robots `b`."""
        first, second = self.candidate.target[0], self.candidate.source[0]
        return (first in a and second in b) or (first in b and second in a)


BLOCK_SHAPE = (16, 64)
"""Rows and columns of a block of cells."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Occupancy as log-odds; row 0 is the lowest y. Free < 0, wall > 0, unknown 0."""

    log_odds: Array
    """(rows, columns) int16."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0] in the map frame."""
    resolution_m: float
    kinds: Array | None = None
    """(rows, columns) uint8, what stands there in short (`slam.cell_kinds`); None: whoever needs it works it out."""
    touched: Array | None = None
    """(blocks, blocks) int64, of each block of `BLOCK_SHAPE` cells another number when one of them may have become
    free, unknown or wall; None: any may have."""

    def cell_of(self, points_m: Array) -> Array:
        """(..., 2) points in the map frame -> (..., 2) integer (row, column); may lie outside."""
        cells = np.floor((np.asarray(points_m) - self.origin_m) / self.resolution_m).astype(np.int64)
        return cells[..., ::-1]

    def centre_of(self, cells: Array) -> Array:
        """(..., 2) integer (row, column) -> (..., 2) points in the map frame."""
        return self.origin_m + (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution_m

    def level_at(self, points_m: Array) -> Array:
        """(..., 2) points in the map frame -> (...) the log-odds there, 0 outside."""
        cells = self.cell_of(points_m)
        inside = np.all((cells >= 0) & (cells < self.log_odds.shape), axis=-1)
        levels = np.zeros(inside.shape, self.log_odds.dtype)
        levels[inside] = self.log_odds[tuple(cells[inside].T)]
        return levels


@_record
class KnownSign:
    """A text that the team has read, where it believes it stands."""

    text: str
    position_m: Array
    """(2,) in the map frame."""


@_record
class Belief:
    """What one robot knows: the merged map of its group and where it is in it. Holds estimates only."""

    robot: int
    step: int
    pose_map_robot: Array
    """(3,)."""
    grid: GridMap
    mates: dict[int, Array] = field(default_factory=dict)
    """Robots of the same group: robot -> (3,) estimated pose in the same map frame, where it was last heard of."""
    signs: tuple[KnownSign, ...] = ()
    ranges_m: Array | None = None
    """(beams,) the robot's latest scan."""
    map_version: int = 0
    """Grows whenever the map jumped (a closure moved it): plans made before should be dropped."""
    pose_odom: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) where its front end has it, in the frame it started in: smooth, never corrected."""
    pose_std: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) how far the path may have strayed since the robot's last closure [m, m, rad]; `reproduce stress` has it
    beside what the error was."""
    since_closure_m: float = 0.0
    """Path length since that closure; since the start where there was none."""
    contact_steps: dict[int, int] = field(default_factory=dict)
    """Other robot -> step of the newest keyframe heard of it; -1: nothing yet."""
    radio_map: GridMap | None = None
    """What signal strength says of the group's map frame: probably free < 0, probably wall > 0. None: not asked for
    (`slam.k_visibility`), or nothing heard yet."""
    transmitter_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2) where the transmitters behind that map are believed to stand."""
