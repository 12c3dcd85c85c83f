"""The robots of a bag as logs of laser scans with poses, in the form that logs of CARMEN have too (`ScanLog`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.scan_log import SAME_DIRECTION_RAD, ScanLog, in_metres
from twc_env.datasets.ros.bag_file import (
    IMU,
    ODOMETRY,
    READ_KINDS,
    SCAN,
    TRANSFORMS,
    Bag,
    Topic,
    opened,
    ros_name,
)
from twc_env.datasets.ros.robot_topics import NONE, RobotTopics, Wishes, choose_topics
from twc_env.datasets.ros.transforms import BASE_FRAMES, Frames, Mount, MovingPairs, clean, heading_of
from twc_env.errors import DataError
from twc_env.records.geometry import compose

TF_READ_MAX = 3000
"""Messages of /tf, at the start of a bag, in which fixed transforms and the names of frames are looked for."""
APART_MAX_S = 0.5
"""A scan further than this before the first or after the last odometry is left out."""
SILENT_S, SILENT_SCANS, SILENT_M = 1.0, 3, 0.5
"""Odometry that is silent for longer, while there are so many scans and the robot moves as far, is reported."""
TILT_MAX_RAD = math.radians(5.0)
"""A scanner tilted by more than this is reported."""
SINGLE = 1e-7
"""Relative error of numbers in single precision."""
SWEEP_MAX_S = 1.0
BEAMS_MAX, TURN_MAX_RAD = 100_000, 2.0 * math.pi + 1e-3
"""Scans with a longer sweep are taken as measured at once; those with more beams, or
over more than a turn, are damaged."""


@dataclass(slots=True)
class RobotLog:
    """One robot of a bag."""

    name: str
    """Its namespace; "" if the bag has none."""
    log: ScanLog
    """Poses are those of the scanner."""
    mount: Array
    """(3,) pose of the scanner in the robot frame."""
    topics: RobotTopics
    notes: list[str] = field(default_factory=list)
    """What was used, assumed or left out, one line each."""


def read_bag(path: str | Path, wishes: Wishes | None = None) -> list[RobotLog]:
    """One log for each robot of a bag. Raises DataError if there is no scan or no odometry, or the bag is damaged."""
    with opened(path) as bag:
        robots = choose_topics(bag.topics, wishes or Wishes(), _Transforms(bag, None).moving_frames, path)
        logs = [_read_robot(bag, robot, wishes or Wishes(), path) for robot in robots]
        used = {robot.scan for robot in robots}
        if others := [
            topic.name for topic in bag.topics if topic.kind == SCAN and topic.count and topic.name not in used
        ]:
            logs[0].notes.append(f"scans of {', '.join(others)} are not used; choose them by --scan-topic")
        return logs


def list_topics(path: str | Path, wishes: Wishes | None = None) -> list[dict[str, Any]]:
    """All topics of a bag, with the frame of the first message, where it is decoded and has one, and what they would be
    used for. Raises DataError as above, but for a missing scan."""
    with opened(path) as bag:
        try:
            robots = choose_topics(bag.topics, wishes or Wishes(), _Transforms(bag, None).moving_frames, path)
        except DataError:
            robots = []
        uses: dict[str, str] = {}
        for robot in robots:
            of_robot = f" of {robot.name}" if robot.name else ""
            for name, use in ((robot.scan, "scan"), (robot.odometry, "odometry"), (robot.imu, "imu")):
                if name is not None:
                    uses[name] = use + of_robot
        rows = []
        for topic in bag.topics:
            use = uses.get(topic.name, "transforms" if topic.kind in TRANSFORMS and robots else "")
            rate = (topic.count - 1) / bag.duration_s if topic.count > 1 and bag.duration_s > 0.0 else 0.0
            rows.append({
                "topic": topic.name, "type": ros_name(topic.kind), "messages": topic.count, "rate [Hz]": round(rate, 2),
                "frame": _frame_of(bag, topic), "used for": use or None,
            })  # fmt: skip
        return rows


def _frame_of(bag: Bag, topic: Topic) -> str | None:
    is_read = topic.count and topic.kind in READ_KINDS
    first = next(iter(bag.messages([topic.name], [topic.kind])), None) if is_read else None
    if first is None:
        return None
    if topic.kind in TRANSFORMS:
        pairs = [f"{t.header.frame_id}->{t.child_frame_id}" for t in first[2].transforms]
        return ", ".join(pairs[:3]) + (", ..." if len(pairs) > 3 else "")
    frame = clean(first[2].header.frame_id)
    return f"{frame}->{clean(first[2].child_frame_id)}" if topic.kind == ODOMETRY else frame or None


class _Transforms:
    """What tf tells about a robot (None: about all): fixed transforms, and those that move."""

    def __init__(self, bag: Bag, robot: RobotTopics | None, has_odometry: bool = True):
        self.fixed, self.moving = Frames(), MovingPairs()
        topics = [topic for topic in bag.topics if topic.kind in TRANSFORMS]
        if robot is not None:
            topics = [t for t in topics if not t.namespace or t.namespace == robot.namespace]
        fixed = [topic.name for topic in topics if topic.name.endswith("tf_static")]
        moving = [topic.name for topic in topics if topic.name not in fixed]
        for _, _, message in bag.messages(fixed, TRANSFORMS):
            for each in message.transforms:
                self.fixed.add(each.header.frame_id, each.child_frame_id, each.transform)
        first: dict[tuple[str, str], tuple] = {}
        changed: set[tuple[str, str]] = set()
        for count, (_, received_s, message) in enumerate(bag.messages(moving, TRANSFORMS)):
            if count >= TF_READ_MAX and has_odometry:
                break
            for each in message.transforms:
                pair = clean(each.header.frame_id), clean(each.child_frame_id)
                place, turn = each.transform.translation, each.transform.rotation
                values = place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w
                if first.setdefault(pair, (values, each.transform))[0] != values:
                    changed.add(pair)
                self.moving.add(*pair, _stamp_s(each.header, received_s), each.transform)
        for pair, (_, transform) in first.items():
            if pair not in changed and "odom" not in pair[0] and "map" not in pair[0]:
                self.fixed.add(*pair, transform)

    @property
    def moving_frames(self) -> set[str]:
        """Names of frames that a transform has as its child."""
        return {child for _, child in self.moving.rows}


def _read_robot(bag: Bag, robot: RobotTopics, wishes: Wishes, path: str | Path) -> RobotLog:
    """The log of one robot."""
    label = f"{path}" + (f" ({robot.name})" if robot.name else "")
    notes: list[str] = []
    tf = _Transforms(bag, robot, has_odometry=robot.odometry is not None)
    scans = _read_scans(bag, robot.scan, label)
    track, base = _read_odometry(bag, robot, tf, label, wishes)
    mount = _mount(tf, base, scans.frame, notes)
    used = f"scans of {robot.scan}, odometry of {robot.odometry or 'tf'}"
    times_s, moving_s = scans.times_s, track.times_s
    if scans.are_received or not _overlap(times_s, moving_s):
        if not _overlap(scans.received_s, track.received_s):
            raise DataError(f"{label}: scans and odometry are of different times; record them together")
        times_s, moving_s = scans.received_s, track.received_s
        notes.append("stamps of scans and odometry do not belong together or are missing: times of reception are used")
    if scans.slow:
        notes.append(
            f"{scans.slow} scans last longer than {SWEEP_MAX_S:g} s by their header: taken as measured at once"
        )
    if track.dropped:
        notes.append(f"{track.dropped} poses of odometry are not finite, or have the time of another: left out")
    if silence := track.silence(times_s, moving_s):
        notes.append(silence)
    gyro = _read_gyro(bag, robot, tf, base, times_s, notes)
    order = np.argsort(times_s, kind="stable")
    if not np.array_equal(order, np.arange(len(order))):
        notes.append("time goes back: scans are put in order of time")
    ends_s = times_s + scans.sweeps_s
    inside = (ends_s[order] >= moving_s[0] - APART_MAX_S) & (ends_s[order] <= moving_s[-1] + APART_MAX_S)
    order = order[inside & np.concatenate([[True], np.diff(times_s[order]) > 0.0])]
    if len(order) < len(times_s):
        notes.append(f"{len(times_s) - len(order)} of {len(times_s)} scans have no odometry, or the time of another")
    if not len(order):
        raise DataError(f"{label}: no scan of {robot.scan} is at a time with odometry; record them together")
    poses = compose(track.at(ends_s[order], moving_s), mount.pose)
    ranges_m, directions = scans.beams(order, mount.is_flipped)
    log = ScanLog(
        ends_s[order], poses, ranges_m, directions,
        sweep_s=float(np.median(scans.sweeps_s)),
        turned_rad=None if gyro is None else np.interp(ends_s[order], *gyro),
    )  # fmt: skip
    if gyro is not None:
        used += f", turn rates of {robot.imu}"
    return RobotLog(robot.name, in_metres(log, label), mount.pose, robot, [used, *notes])


def _overlap(first_s: Array, second_s: Array) -> bool:
    return bool(first_s.min() <= second_s.max() + APART_MAX_S and second_s.min() <= first_s.max() + APART_MAX_S)


def _stamp_s(header: Any, received_s: float) -> float:
    """Time of a message [s]; that of reception if its header has none."""
    stamp = header.stamp
    return stamp.sec + 1e-9 * stamp.nanosec if stamp.sec or stamp.nanosec else received_s


@dataclass(slots=True)
class _Scans:
    frame: str
    times_s: Array
    received_s: Array
    sweeps_s: Array
    """(scans,) time from the first beam to the last."""
    rows: list[Array]
    """Ranges of each scan, float32; no return: infinite."""
    angles: Array
    """(scans, 2) direction of the first beam, and step [deg]."""
    are_received: bool
    slow: int
    """Number of scans whose sweep is longer than SWEEP_MAX_S, or not finite."""

    def beams(self, chosen: Array, is_flipped: bool) -> tuple[Array, Array]:
        """Ranges (scans, beams), and directions (beams,) or (scans, beams) in the frame of the mount's pose."""
        count = max(len(self.rows[k]) for k in chosen)
        ranges_m = np.full((len(chosen), count), np.inf, np.float32)
        for row, k in zip(ranges_m, chosen, strict=True):
            row[: len(self.rows[k])] = self.rows[k]
        sign = -1.0 if is_flipped else 1.0
        angles = sign * self.angles[chosen]
        if (np.radians(np.abs(angles - angles[0]).max(axis=0)) * [1.0, count] <= SAME_DIRECTION_RAD).all():
            return ranges_m, np.deg2rad(angles[0, 0] + angles[0, 1] * np.arange(count))
        return ranges_m, np.deg2rad(angles[:, :1] + angles[:, 1:] * np.arange(count))


def _read_scans(bag: Bag, topic: str, label: str) -> _Scans:
    rows, numbers, frame, reason, slow = [], [], "", "", 0
    for _, received_s, scan in bag.messages([topic], [SCAN]):
        values = (scan.angle_min, scan.angle_increment, scan.time_increment, scan.range_min, scan.range_max)
        first, step, between_s, least, most = map(float, values)
        ranges_m = np.asarray(scan.ranges, np.float32)
        stamp_s = scan.header.stamp.sec + 1e-9 * scan.header.stamp.nanosec
        frame = frame or clean(scan.header.frame_id)
        if not 1 <= len(ranges_m) <= BEAMS_MAX:
            reason = f"{len(ranges_m)} ranges"
        elif not (math.isfinite(first) and 0.0 < abs(step) * max(len(ranges_m) - 1, 1) <= TURN_MAX_RAD):
            reason = f"{len(ranges_m)} beams from {first:g} in steps of {step:g} rad, which are on no circle"
        else:
            sweep_s = abs(between_s) * (len(ranges_m) - 1)
            is_slow = not (math.isfinite(sweep_s) and sweep_s <= SWEEP_MAX_S)
            sweep_s, slow = 0.0 if is_slow else sweep_s, slow + is_slow
            most = most if math.isfinite(most) and most > 0.0 else math.inf
            least = least if math.isfinite(least) else 0.0
            with np.errstate(invalid="ignore"):
                is_return = (ranges_m > 0.0) & (ranges_m >= np.float32(least)) & (ranges_m < np.float32(most))
            rows.append(np.where(is_return, ranges_m, np.float32(np.inf)))
            numbers.append((stamp_s, received_s, sweep_s, first, step))
            continue
        raise DataError(f"{label}: scan {len(rows)} of {topic} has {reason}; record the bag again")
    if not rows:
        raise DataError(f"{label}: no message of {topic} can be read; record the bag again")
    table = np.array(numbers)
    are_received = not table[:, 0].any()
    return _Scans(frame, table[:, 0], table[:, 1], table[:, 2], rows, _decimal_deg(table[:, 3:]), are_received, slow)


def _decimal_deg(angles_rad: Array) -> Array:
    """Angles [deg] that were rounded to single precision, as the thousandths of degrees that they stand for, if so."""
    thousandths = np.degrees(angles_rad) * 1000.0
    is_meant = np.abs(thousandths - np.rint(thousandths)) <= SINGLE * np.abs(thousandths)
    return np.where(is_meant, np.rint(thousandths), thousandths) / 1000.0


@dataclass(slots=True)
class _Track:
    """Poses by odometry over time."""

    times_s: Array
    received_s: Array
    poses: Array
    """(k, 3), heading not wrapped."""
    dropped: int
    """Number of poses left out."""

    def at(self, times_s: Array, own_s: Array) -> Array:
        """(scans, 3) interpolated poses; own_s: the times of this track on the clock of the others."""
        return np.stack([np.interp(times_s, own_s, column) for column in self.poses.T], axis=1)

    def silence(self, times_s: Array, own_s: Array) -> str:
        """The longest time without odometry in which the robot moves and there are scans, at times_s; "" if none."""
        passed_s, moved_m = np.diff(own_s), np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        scans = np.diff(np.searchsorted(np.sort(times_s), own_s))
        is_silent = (passed_s > SILENT_S) & (moved_m > SILENT_M) & (scans >= SILENT_SCANS)
        if not is_silent.any():
            return ""
        longest = int(np.argmax(np.where(is_silent, passed_s, 0.0)))
        return (
            f"no odometry for {passed_s[longest]:.3g} s, {own_s[longest] - times_s.min():.1f} s after the first scan: "
            f"{scans[longest]} scans are laid on a straight way of {moved_m[longest]:.3g} m, and if odometry began "
            "anew there, the map is wrong from there on"
        )


def _read_odometry(bag: Bag, robot: RobotTopics, tf: _Transforms, label: str, wishes: Wishes) -> tuple[_Track, str]:
    """Poses by an Odometry topic or by tf, and the name of the robot frame ("": unknown)."""
    rows: list[tuple[float, ...]] = []
    base = ""
    if robot.odometry is not None:
        for _, received_s, message in bag.messages([robot.odometry], [ODOMETRY]):
            pose = message.pose.pose
            heading = heading_of(pose.orientation)
            rows.append((_stamp_s(message.header, received_s), received_s, pose.position.x, pose.position.y, heading))
            base = base or clean(message.child_frame_id)
    else:
        pair = tf.moving.odometry(robot.name)
        if pair is not None:
            base = pair[1]
            rows = [(time_s, time_s, x, y, heading) for time_s, x, y, heading in tf.moving.rows[pair]]
    table = np.array(rows, float).reshape(-1, 5)
    table = table[np.isfinite(table).all(axis=1)]
    if not len(table):
        chosen = " (--odom-topic none)" if NONE in wishes.odometry else ""
        raise DataError(
            f"{label} has no odometry: neither a topic of nav_msgs/Odometry nor a transform from odom to "
            f"{' or '.join(BASE_FRAMES[:2])} in tf{chosen}; record one, or name it by --odom-topic"
        )
    table = table[np.argsort(table[:, 0], kind="stable")]
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0.0])]
    table[:, 4] = np.unwrap(table[:, 4])
    return _Track(table[:, 0], table[:, 1], table[:, 2:], len(rows) - len(table)), base


def _mount(tf: _Transforms, base: str, frame: str, notes: list[str]) -> Mount:
    """Where the scanner is on the robot; at its centre, ahead, if tf does not say."""
    named = base if base and tf.fixed.between(base, frame) is not None else tf.fixed.base_of(frame)
    found = tf.fixed.mount(named, frame) if named is not None else None
    if found is None:
        notes.append(
            f"no transform from the robot's frame {base or 'base_link'} to the scanner's {frame or '(no name)'}: the "
            "scanner is taken to be at the robot's centre, looking ahead"
        )
        return Mount(np.zeros(3), False, 0.0)
    if found.tilt_rad > TILT_MAX_RAD:
        notes.append(f"the scanner is tilted by {math.degrees(found.tilt_rad):.0f} degrees: ranges are taken as level")
    x, y, turn = found.pose
    down = ", upside down" if found.is_flipped else ""
    notes.append(f"scanner at x {x:.3f} m, y {y:.3f} m, turned by {math.degrees(turn):.1f} degrees{down} on {named}")
    return found


def _read_gyro(
    bag: Bag, robot: RobotTopics, tf: _Transforms, base: str, scans_s: Array, notes: list[str]
) -> tuple[Array, Array] | None:
    """Times (k,) and headings (k,) [rad] by the gyro, each of whose samples holds since the one before; None if there
    is none whose samples span the scans."""
    if robot.imu is None:
        return None
    samples: list[tuple[float, float]] = []
    upward, frame = np.array([0.0, 0.0, 1.0]), None
    for _, received_s, message in bag.messages([robot.imu], [IMU]):
        if frame is None:
            frame = clean(message.header.frame_id)
            known = tf.fixed.between(base, frame) if base else None
            upward = upward if known is None else known[2, :3]
        rate = message.angular_velocity
        turn_rate = float(upward @ np.array([rate.x, rate.y, rate.z]))
        samples.append((_stamp_s(message.header, received_s), turn_rate))
    table = np.array(samples, float).reshape(-1, 2)
    table = table[np.isfinite(table).all(axis=1)]
    table = table[np.argsort(table[:, 0], kind="stable")]
    if len(table) < 2 or table[0, 0] > scans_s.min() + 1.0 or table[-1, 0] < scans_s.max() - 1.0:
        notes.append(f"{robot.imu} does not span the scans, or has no rates: it is not used")
        return None
    elapsed_s = np.diff(table[:, 0], prepend=table[0, 0])
    return table[:, 0], np.cumsum(elapsed_s * table[:, 1])


def describe(logs: Iterable[RobotLog]) -> Sequence[str]:
    """What was used of a bag, one line for each robot."""
    return [f"{log.name or 'robot'}: {'; '.join(log.notes)}" for log in logs]
