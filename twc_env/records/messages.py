"""The records exchanged between packages. None of them can hold a true pose.

Frames: `robot` is the body frame (x ahead, y left); `odom` is where one robot's front end started (continuous, drifts);
`map` is the frame of the merged map of the robot's group (jumps when closures arrive). `pose_map_robot` is the pose of
the robot in the map frame, as (x [m], y [m], heading [rad]).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NoReturn, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.scanner import Scanner

_Record = TypeVar("_Record")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def _record(kind: type[_Record]) -> type[_Record]:
    """A record that only type checkers treat as frozen; freezing it at run time would triple the cost of creating
    it."""
    return dataclass(slots=True, eq=False)(kind)


UNSEEN_M = -0.001
"""Range of a beam without information, as behind a scanner with a limited field of view: neither free nor wall."""


@_record
class WifiScan:
    """One sweep over the radio channels: the transmitters heard and how strongly."""

    macs: Array
    """(heard,) int64, ascending: the 48-bit MAC addresses heard; LTE cells have numbers of 2^48 and above."""
    rssi_dbm: Array
    """(heard,) float64, RSSI of each."""
    age_s: Array | None = None
    """(heard,) float64, age of each reading; None: all from this sweep."""


@dataclass(frozen=True, slots=True)
class SignReading:
    """One sign reading of the camera: the OCR output, possibly misread."""

    text: str
    bearing_rad: float
    """Direction of the sign's centre in the robot frame."""
    range_m: float
    """Measured distance to the sign's centre."""


@_record
class SensorFrame:
    """All measurements of one robot in one step: the engine's only input."""

    robot: int
    step: int
    time_s: float
    """Time on the robot's own clock, which may start anywhere and jump forward, but not back."""
    odometry: Array
    """(3,) odometry: motion since the previous frame, in the robot frame of that frame [m, m, rad]."""
    turn_rate_rad_s: float
    """Gyro turn rate, averaged since the previous frame."""
    ranges_m: Array
    """(beams,) beam i points to 2 pi i / beams in the robot frame; no return is the scanner's maximum range. (0,) if no
    scan was completed in this step.

    A negative range means free up to there but no wall; `UNSEEN_M` means no information; 0 is rejected. Of a frame with
    a `scanner`, that tells how to read them."""
    wifi: WifiScan | None = None
    """The WiFi scan completed in this step, if any."""
    signs: tuple[SignReading, ...] = ()
    scanner: Scanner | None = None
    """Geometry of the scan; None: as told above, all beams at once."""


@_record
class Fingerprint:
    """The radio fingerprint of a place: outlier-free mean RSSI of each transmitter (TWC-SLAM Eq. 7-8)."""

    macs: Array
    """(heard,) int64, ascending."""
    rssi_dbm: Array
    """(heard,) float64."""


@_record
class SignObservation:
    """A sign read near a keyframe, positioned in the keyframe's robot frame."""

    text: str
    position_m: Array
    """(2,)."""
    facing_rad: float
    """Outward normal of its wall according to the local map; NaN if the map shows no wall there."""


@_record
class Keyframe:
    """A keyframe: pose estimated by the front end, and what was sensed there."""

    robot: int
    index: int
    """Index among the robot's own keyframes, from 0."""
    step: int
    time_s: float
    """Since the robot's first frame."""
    pose_odom: Array
    """(3,) pose in the robot's odom frame."""
    motion: Array
    """(3,) pose relative to the previous keyframe (zeros for the first)."""
    motion_covariance: Array
    """(3, 3) covariance of `motion` [m2, m rad, rad2], along the axes of this keyframe's own frame."""
    travel_m: float
    """Path length so far."""
    ranges_m: Array
    """(beams,) the scan taken here; negative if the beam hit a teammate: free up to there, but no wall."""
    signs: tuple[SignObservation, ...]
    """Texts read since the last keyframe."""
    fingerprint: Fingerprint
    team_step: int = -1
    """The engine's step when the frame came in: comparable between robots, unlike `step`; -1: unknown."""
    by_odometry_m: tuple[float, float] = (0.0, 0.0)
    """The part of `motion` left unconstrained by scan matching, as along a corridor, in this keyframe's axes."""
    odometry_scale: tuple[float, float] = (0.0, 0.0)
    """Estimated scale error of the odometry and its standard deviation; zeros while scan matching constrains
    everything."""
    begins_segment: bool = False
    """Whether the robot was lifted and put down here: `motion` says nothing, and a map of its own begins."""

    @property
    def key(self) -> tuple[int, int]:
        """(robot, index), by which closures and messages name it."""
        return self.robot, self.index


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Radio contacts in one step. Rows are listeners (all robots, or the central mapper), columns are senders."""

    tried: Array
    """(listeners, robots) bool: in range, so that messages were sent."""
    heard: Array
    """(listeners, robots) bool: and were received."""


@_record
class LoopCandidate:
    """A loop candidate: two keyframes that look like the same place, not yet verified by geometry."""

    target: tuple[int, int]
    """(robot, keyframe index)."""
    source: tuple[int, int]
    guess: Array
    """(3,) initial guess of the source's pose in the target's frame."""
    recogniser: str
    """Its source: "twc", "text", "wifi", "lidar", "fused" or "proximity" (close in the current
    estimate)."""
    sign_m: Array | None = None
    """(2,) the sign that both saw, in the target's frame; None without a sign."""
    text_similarity: float = float("nan")
    mac_similarity: float = float("nan")
    rssi_similarity: float = float("nan")
    log_odds: float = float("nan")
    """Of `fused`: log-odds that this is one place."""

    @property
    def is_read_alike(self) -> bool:
        """Whether the two texts are equal, or were not compared."""
        return not self.text_similarity < 1.0


LOOSE_M = 0.5
"""A closure with a larger standard deviation in some direction leaves that direction unconstrained."""


def is_loose(covariance: Array) -> bool:
    """Whether a closure with this covariance (3, 3) leaves a direction unconstrained."""
    return bool(covariance[0, 0] + covariance[1, 1] > LOOSE_M**2)


@dataclass(slots=True, eq=False)
class LoopClosure:
    """A candidate after scan matching, and its current status in the back end."""

    candidate: LoopCandidate
    pose_target_source: Array
    """(3,) measured pose of the source in the target's frame."""
    covariance: Array
    """(3, 3) covariance of the measurement in the axes of the source's frame, as in g2o files."""
    overlap: float
    """Share of the source's points on the target's walls."""
    status: str
    """"accepted", "pending" (waiting for consistent closures) or "rejected"."""
    reason: str = ""
    """Why it is not accepted."""
    number: int = -1
    """Its index among the closures of the mapper that verified it."""

    @property
    def is_loose(self) -> bool:
        """Whether it leaves a direction unconstrained, as in a bare corridor, where scans fit anywhere along it."""
        return is_loose(self.covariance)

    def joins(self, a: Collection[int], b: Collection[int]) -> bool:
        """Whether one end is a keyframe of robots `a` and the other of robots `b`."""
        first, second = self.candidate.target[0], self.candidate.source[0]
        return (first in a and second in b) or (first in b and second in a)


BLOCK_SHAPE = (16, 64)
"""Rows and columns of a block of cells."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class GridMap:
    """Occupancy as log-odds; row 0 is the lowest y. Free < 0, wall > 0, unknown 0."""

    log_odds: Array
    """(rows, columns) int16."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0] in the map frame."""
    resolution_m: float
    kinds: Array | None = None
    """(rows, columns) uint8, class of each cell (`slam.cell_kinds`); None: computed on demand."""
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
    """A sign that the team has read, at its estimated position."""

    text: str
    position_m: Array
    """(2,) in the map frame."""


@_record
class MergeHypothesis:
    """How the map of another group may lie in this one, by loop closures that do not suffice to merge them yet.

    It may be wrong: the engine waits for closures that agree."""

    robots: tuple[int, ...]
    """The other group; () for the map of an earlier session."""
    pose_map_other: Array
    """(3,) pose of the other group's map frame in this map."""
    support: int
    """Number of pending closures that agree with it; merging takes about three, at two places."""
    signs: tuple[KnownSign, ...]
    """What the other group has read, where it would be in this map."""
    teammates: dict[int, Array]
    """Robots of the other group -> (3,) pose at their newest keyframe, as it would be in this map."""


@_record
class RadioTrail:
    """What the robots of one map have heard of access points, and where: known of others before maps are merged."""

    robots: tuple[int, ...]
    """() for the map of an earlier session, and for what a robot mapped before it was carried away."""
    places_m: Array
    """(k, 2) of their keyframes, in the frame of their own map."""
    fingerprints: tuple[Fingerprint, ...]
    """(k,)."""


@_record
class Belief:
    """What one robot knows: the merged map of its group and its pose in it. Estimates only."""

    robot: int
    step: int
    pose_map_robot: Array
    """(3,)."""
    grid: GridMap
    """The map that the engine goes on drawing: it changes with the next steps. `copy.deepcopy(belief)` keeps this
    moment."""
    teammates: dict[int, Array] = field(default_factory=dict)
    """Other robots of the group -> (3,) estimated pose in the same map frame: current with a central mapper, as of the
    newest keyframe received with one mapper per robot."""
    signs: tuple[KnownSign, ...] = ()
    ranges_m: Array | None = None
    """(beams,) the robot's latest scan."""
    map_version: int = 0
    """Incremented when the map jumps because of a closure; older plans should be discarded."""
    pose_odom: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) pose according to its front end, in the frame in which it started: continuous, never corrected."""
    pose_std: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) standard deviation of the drift since the robot's last closure [m, m, rad], so exactly 0 just after one: not
    the marginal covariance of the pose, as errors of the map are no part of it. `reproduce stress` compares it with the
    actual error."""
    since_closure_m: float = 0.0
    """Path length since that closure, or since the start."""
    contact_steps: dict[int, int] = field(default_factory=dict)
    """Other robot -> step of the last contact with it: when the mapper whose map this robot uses last received a
    transmission of the other robot itself. With a central mapper that is the same step for all robots; with one mapper
    per robot only direct contact counts, not what others forward. -1: none yet. A robot in contact has the current step
    even if it stands still and has nothing new to send."""
    radio_map: GridMap | None = None
    """Map estimated from signal strength, in the group's map frame: probably free < 0, probably wall > 0. None:
    disabled (`slam.k_visibility`), or nothing heard yet."""
    transmitter_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2) estimated positions of the transmitters used for that map."""

    @property
    def mates(self) -> NoReturn:
        """The name of `teammates` until version 0.1.0."""
        raise AttributeError("Belief.mates is now Belief.teammates")

    hypotheses: tuple[MergeHypothesis, ...] = ()
    """The best supported one for each group with which this robot's map is not merged, if there is any."""
    radio_trails: tuple[RadioTrail, ...] = ()
    """While there are other maps: that of this robot's own group, then that of each other group whose keyframes its
    mapper has received; with one mapper per robot that is what robots in contact passed on."""
