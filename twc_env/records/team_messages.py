"""Frames and beliefs of a whole team in one step: arrays over robots, with records of single robots on demand.

Both are sequences of the records in `messages`: index them for one robot, or use the arrays for all robots at once.
Like the records, they cannot hold a true pose.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import UNSEEN_M, Belief, GridMap, KnownSign, SensorFrame, SignReading, WifiScan
from twc_env.records.scanner import Scanner

_Record = TypeVar("_Record")


def read_only(array: Array) -> Array:
    """A read-only view for users; the engine passes the array itself, whose type kernels recognise fastest."""
    view = array.view()
    view.flags.writeable = False
    return view


class _Team(Sequence[_Record]):
    """Records that are created on first access."""

    __slots__ = ("_records",)

    is_stacked = True
    """A marker that is faster to check than `isinstance` with an abstract class."""
    _records: list[_Record] | None

    @abstractmethod
    def _make(self) -> list[_Record]:
        """One record for each robot."""

    def _all(self) -> list[_Record]:
        if self._records is None:
            self._records = self._make()
        return self._records

    def __getitem__(self, robot):
        return self._all()[robot]

    def __iter__(self) -> Iterator[_Record]:
        return iter(self._all())


class WifiScans(NamedTuple):
    """The WiFi scans that robots completed in one step, concatenated."""

    robots: Array
    """(k,) int64: the robot of each scan."""
    macs: Array
    """(k, most) int64, ascending; only the first `counts` of a row are valid."""
    rssi_dbm: Array
    """(k, most) float64."""
    counts: Array
    """(k,) int64."""

    @classmethod
    def of(cls, scans: Sequence[WifiScan | None]) -> WifiScans:
        """The scans of robots 0, 1, ... without None; ages are left out."""
        heard = [(robot, scan) for robot, scan in enumerate(scans) if scan is not None]
        counts = [len(scan.macs) for _, scan in heard]
        shape = len(heard), max(counts, default=0)
        macs, rssi_dbm = np.zeros(shape, np.int64), np.zeros(shape)
        for k, (_, scan) in enumerate(heard):
            macs[k, : counts[k]], rssi_dbm[k, : counts[k]] = scan.macs, scan.rssi_dbm
        return cls(np.array([robot for robot, _ in heard], np.int64), macs, rssi_dbm, np.array(counts, np.int64))

    def each(self, robot_count: int) -> list[WifiScan | None]:
        """One scan per robot; None for a robot that completed none."""
        scans: list[WifiScan | None] = [None] * robot_count
        for k, (robot, count) in enumerate(zip(self.robots.tolist(), self.counts.tolist(), strict=True)):
            scans[robot] = WifiScan(self.macs[k, :count], self.rssi_dbm[k, :count])
        return scans


class TeamFrames(_Team[SensorFrame]):
    """The frames of all robots in one step."""

    __slots__ = (
        "_wifi", "beams", "has_scan", "may_repeat_readings", "odometry", "ranges_m", "scanner", "scans", "signs",
        "step", "time_s", "turn_rates_rad_s",
    )  # fmt: skip

    def __init__(
        self,
        step: int,
        time_s: float,
        odometry: Array,
        turn_rates_rad_s: Array,
        ranges_m: Array,
        wifi: WifiScans | Sequence[WifiScan | None],
        signs: Sequence[tuple[SignReading, ...]],
        scanner: Scanner | tuple[Scanner, ...] | None = None,
        has_scan: Array | None = None,
        beams: tuple[int, ...] | None = None,
    ):
        """One row per robot, as the fields of `SensorFrame`; records hold read-only views of the rows.

        Arrays are float64 and contiguous. `scans` are those of `wifi` in arrays; `may_repeat_readings` says whether a
        scan may hold readings of earlier sweeps (never if `wifi` is given as arrays). scanner: that of all robots, or
        of each. has_scan (robots,) bool: whether each completed a scan in this step, else its row repeats the latest
        one; None: all did. beams (robots,): how many of each row are of the robot's scan; None: all.
        """
        self._records = None
        self.step, self.time_s = step, time_s
        self.odometry, self.turn_rates_rad_s, self.ranges_m = odometry, turn_rates_rad_s, ranges_m
        self.signs, self.scanner, self.has_scan, self.beams = signs, scanner, has_scan, beams
        self._wifi: Sequence[WifiScan | None] | None
        if isinstance(wifi, WifiScans):
            self.scans, self._wifi, self.may_repeat_readings = wifi, None, False
        else:
            self.scans, self._wifi = WifiScans.of(wifi), wifi
            self.may_repeat_readings = any([scan is not None and scan.age_s is not None for scan in wifi])

    @property
    def raw_wifi(self) -> WifiScans | Sequence[WifiScan | None]:
        """The WiFi scans in the form in which they were given."""
        return self.scans if self._wifi is None else self._wifi

    @property
    def wifi(self) -> Sequence[WifiScan | None]:
        """The scan of each robot, or None if it completed none."""
        if self._wifi is None:
            self._wifi = self.scans.each(len(self))
        return self._wifi

    @classmethod
    def of(cls, frames: Sequence[SensorFrame]) -> TeamFrames:
        """Frames of one step, stacked, one row per frame."""
        if isinstance(frames, TeamFrames):
            return frames
        counts = [len(frame.ranges_m) for frame in frames]
        scanners = tuple(frame.scanner for frame in frames)
        is_mixed = len({count for count in counts if count}) > 1 or any(each != scanners[0] for each in scanners)
        has_scan = None if all(counts) else np.array(counts) > 0
        ranges_m = np.full((len(frames), max(counts)), UNSEEN_M)
        for row, frame, count in zip(ranges_m, frames, counts, strict=True):
            row[:count] = frame.ranges_m
        team = cls(
            frames[0].step,
            float(frames[0].time_s),
            np.array([frame.odometry for frame in frames], float),
            np.array([frame.turn_rate_rad_s for frame in frames], float),
            ranges_m,
            [frame.wifi for frame in frames],
            [frame.signs for frame in frames],
            scanners if is_mixed else frames[0].scanner,  # type: ignore[arg-type]
            has_scan,
            tuple(counts) if is_mixed else None,
        )
        team._records = list(frames)
        return team

    def __len__(self) -> int:
        return len(self.signs)

    def _make(self) -> list[SensorFrame]:
        odometry, ranges_m = read_only(self.odometry), self._scans_each()
        rows = zip(odometry, self.turn_rates_rad_s.tolist(), ranges_m, self.wifi, self.signs, strict=True)
        scanners = self.scanner if isinstance(self.scanner, tuple) else (self.scanner,) * len(self)
        return [SensorFrame(robot, self.step, self.time_s, *row, scanners[robot]) for robot, row in enumerate(rows)]

    def _scans_each(self) -> Sequence[Array]:
        """The new scan of each robot; (0,) without one."""
        ranges_m: Sequence[Array] | Array = read_only(self.ranges_m)
        if self.beams is not None:
            ranges_m = [row[:count] for row, count in zip(ranges_m, self.beams, strict=True)]
        if self.has_scan is None:
            return list(ranges_m)
        return [row if has_scan else row[:0] for row, has_scan in zip(ranges_m, self.has_scan.tolist(), strict=True)]


class KnownSigns(_Team[KnownSign]):
    """The signs that a group of robots has read, each once per place."""

    __slots__ = ("_tuple", "places_m", "texts")

    def __init__(self, texts: Sequence[str], places_m: Array):
        """Texts and positions (k, 2) in the map frame; records hold read-only views of these."""
        self._records = None
        self._tuple: tuple[KnownSign, ...] | None = None
        self.texts, self.places_m = texts, places_m

    @classmethod
    def of(cls, signs: Sequence[KnownSign]) -> KnownSigns:
        """The signs in arrays."""
        if isinstance(signs, KnownSigns):
            return signs
        return cls([sign.text for sign in signs], np.array([sign.position_m for sign in signs]).reshape(-1, 2))

    @property
    def records(self) -> tuple[KnownSign, ...]:
        """All signs, as in `Belief.signs`."""
        if self._tuple is None:
            self._tuple = tuple(self)
        return self._tuple

    def __len__(self) -> int:
        return len(self.texts)

    def _make(self) -> list[KnownSign]:
        return [KnownSign(*sign) for sign in zip(self.texts, read_only(self.places_m), strict=True)]


NOBODY = -2
"""Stands for no robot, or for no step of contact: before the first step, and without an engine."""


def nobody(robots: int) -> tuple[Array, Array, Array]:
    """Teammates, their poses and contact steps, as in `TeamBeliefs`, of robots without any contact."""
    shape = robots, max(robots - 1, 0)
    return np.full(shape, NOBODY), np.zeros((*shape, 3)), np.full(shape, NOBODY)


class TeamBeliefs(_Team[Belief]):
    """The beliefs of all robots after one step."""

    __slots__ = ("contact_steps", "grids", "poses", "signs", "since_closure_m", "teammate_poses", "teammates")

    def __init__(
        self,
        poses: Array,
        since_closure_m: Array,
        grids: Sequence[GridMap],
        signs: Sequence[Sequence[KnownSign]],
        teammates: Array,
        teammate_poses: Array,
        contact_steps: Array,
    ):
        """Arrays with one row per robot, not modified afterwards; records hold read-only views of them.

        poses (robots, 3, 3): `pose_map_robot`, `pose_std` and `pose_odom`. teammates (robots, robots - 1) int: the
        other robots in the same map, then `NOBODY`; teammate_poses (robots, robots - 1, 3): their poses. contact_steps
        (robots, robots - 1) int: `Belief.contact_steps` of all other robots in order; `NOBODY`: no entry.
        """
        self._records = None
        self.poses, self.since_closure_m, self.grids = poses, since_closure_m, grids
        self.signs, self.contact_steps = signs, contact_steps
        self.teammates, self.teammate_poses = teammates, teammate_poses

    @property
    def map_versions(self) -> Sequence[int]:
        """`Belief.map_version` of each robot."""
        return [belief.map_version for belief in self]

    @property
    def ranges_m(self) -> Sequence[Array | None] | Array:
        """The latest scan of each robot; an array (robots, beams) where all are of one length."""
        return [belief.ranges_m for belief in self]

    def teammates_of(self, robot: int) -> dict[int, Array]:
        """`Belief.teammates` of a robot."""
        teammates = zip(self.teammates[robot].tolist(), read_only(self.teammate_poses[robot]), strict=True)
        return {teammate: pose for teammate, pose in teammates if teammate >= 0}

    def contact_steps_of(self, robot: int) -> dict[int, int]:
        """`Belief.contact_steps` of a robot."""
        others = [r for r in range(len(self)) if r != robot]
        steps = zip(others, self.contact_steps[robot].tolist(), strict=True)
        return {other: step for other, step in steps if step != NOBODY}

    @classmethod
    def of(cls, beliefs: Sequence[Belief]) -> TeamBeliefs:
        """Beliefs of robots 0, 1, ... after one step, stacked."""
        if hasattr(beliefs, "is_stacked"):
            stacked: Any = beliefs
            return stacked
        rows = [pose for b in beliefs for pose in (b.pose_map_robot, b.pose_std, b.pose_odom)]
        teammates, teammate_poses, contact_steps = nobody(len(beliefs))
        for k, belief in enumerate(beliefs):
            teammates[k, : len(belief.teammates)] = list(belief.teammates)
            for row, pose in zip(teammate_poses[k], belief.teammates.values(), strict=False):
                row[:] = pose
            for other, step in belief.contact_steps.items():
                contact_steps[k, other if other < k else other - 1] = step
        team = _GivenBeliefs(
            np.concatenate(rows).reshape(-1, 3, 3),
            np.array([belief.since_closure_m for belief in beliefs]),
            [belief.grid for belief in beliefs],
            [belief.signs for belief in beliefs],
            teammates,
            teammate_poses,
            contact_steps,
        )
        team._records = list(beliefs)
        return team

    def __len__(self) -> int:
        return len(self.grids)


class _GivenBeliefs(TeamBeliefs):
    """Stacked beliefs that keep the records they were made of."""

    __slots__ = ()

    def _make(self) -> list[Belief]:
        return self._records or []
