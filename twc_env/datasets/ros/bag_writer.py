"""Bags written: logs of robots as their drivers would record them, and what the engine has estimated.

A name that ends in .bag is a bag of ROS 1, one in .mcap or .db3 a file of ROS 2, any other a folder of ROS 2.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.ros.bag_file import IMU, ODOMETRY, SCAN, TRANSFORMS, typestore
from twc_env.errors import DataError
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import GridMap
from twc_env.records.scanner import Scanner

GRID, PATH = "nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Path"
_VERSION = 9
"""Of the format of ROS 2 bags."""
_STAMP_MAX = 2**31


@dataclass(frozen=True, slots=True, eq=False)
class RobotRecording:
    """What the drivers of one robot publish."""

    namespace: str
    """"" for none."""
    times_s: Array
    """(scans,)."""
    odometry: Array
    """(scans, 3) poses of the robot in its odom frame."""
    ranges_m: Sequence[Array]
    """Ranges of each scan, as the scanner gives them."""
    scanner: Scanner
    """Its geometry; a rolling scan ends at the time of its row."""
    turn_rates_rad_s: Array | None = None
    """(scans,) mean turn rate since the scan before."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotEstimate:
    """The estimated path of one robot."""

    namespace: str
    map_frame: str
    times_s: Array
    poses: Array
    """(k, 3) in the map frame."""
    logged: Array
    """(k, 3) by odometry, in the odom frame."""
    is_known: Array
    """(k,) bool: whether there is a pose in the map frame."""


class _Recorder:
    """Messages of one bag, put in order of time when it is written."""

    def __init__(self, is_ros2: bool):
        self.store, self._is_ros2 = typestore(is_ros2), is_ros2
        self.rows: list[tuple[float, int, str, str, Any]] = []
        """Time, number, topic, type and message."""

    def kind(self, name: str) -> Any:
        """A message class, by its type."""
        return self.store.types[name]

    def header(self, time_s: float, frame: str) -> Any:
        seconds = math.floor(time_s)
        nanoseconds = round((time_s - seconds) * 1e9)
        seconds, nanoseconds = seconds + nanoseconds // 10**9, nanoseconds % 10**9
        if not 0 <= seconds < _STAMP_MAX:
            raise DataError(f"{time_s:g} s is no time that ROS has: it counts seconds from 0 to {_STAMP_MAX}")
        stamp = self.kind("builtin_interfaces/msg/Time")(sec=int(seconds), nanosec=int(nanoseconds))
        more = {} if self._is_ros2 else {"seq": 0}
        return self.kind("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **more)

    def add(self, time_s: float, topic: str, kind: str, **fields: Any) -> None:
        """Add a message."""
        self.rows.append((time_s, len(self.rows), topic, kind, self.kind(kind)(**fields)))

    def point(self, pose: Array, kind: str = "Point") -> Any:
        return self.kind(f"geometry_msgs/msg/{kind}")(x=float(pose[0]), y=float(pose[1]), z=0.0)

    def turn(self, heading: float) -> Any:
        half = 0.5 * heading
        return self.kind("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))

    def pose(self, pose: Array) -> Any:
        return self.kind("geometry_msgs/msg/Pose")(position=self.point(pose), orientation=self.turn(float(pose[2])))

    def transform(self, time_s: float, topic: str, parent: str, child: str, pose: Array) -> None:
        """Add a transform to a topic of tf."""
        moved = self.kind("geometry_msgs/msg/Transform")(
            translation=self.point(pose, "Vector3"), rotation=self.turn(float(pose[2]))
        )
        stamped = self.kind("geometry_msgs/msg/TransformStamped")(
            header=self.header(time_s, parent), child_frame_id=child, transform=moved
        )
        self.add(time_s, topic, TRANSFORMS[0], transforms=[stamped])

    def odometry(self, time_s: float, topic: str, parent: str, child: str, pose: Array) -> None:
        """Add a pose, with zeros for what is not known."""
        zeros = np.zeros(36)
        still = self.kind("geometry_msgs/msg/Twist")(
            linear=self.point(np.zeros(3), "Vector3"), angular=self.point(np.zeros(3), "Vector3")
        )
        self.add(
            time_s, topic, ODOMETRY, header=self.header(time_s, parent), child_frame_id=child,
            pose=self.kind("geometry_msgs/msg/PoseWithCovariance")(pose=self.pose(pose), covariance=zeros),
            twist=self.kind("geometry_msgs/msg/TwistWithCovariance")(twist=still, covariance=zeros),
        )  # fmt: skip

    def write(self, writer: Any) -> None:
        """Write all messages."""
        links: dict[str, Any] = {}
        encode = self.store.serialize_cdr if self._is_ros2 else self.store.serialize_ros1
        for time_s, _, topic, kind, message in sorted(self.rows, key=lambda row: row[:2]):
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=self.store)
            writer.write(links[topic], max(round(time_s * 1e9), 0), encode(message, kind))


@contextmanager
def _recorder(path: Path) -> Iterator[_Recorder]:
    """Collects messages, and writes them to a new bag at the end."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError as error:
        raise DataError(f"writing the bag {path} needs `pip install 'twc_env[ros]'`") from error
    if path.exists():
        raise DataError(f"{path} exists: bags are not overwritten; name another, or delete it")
    path.parent.mkdir(parents=True, exist_ok=True)
    recorder = _Recorder(is_ros2=path.suffix != ".bag")
    yield recorder
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".part-") as name:
        place = Path(name) / path.name
        if path.suffix == ".bag":
            with rosbag1.Writer(place) as writer:
                recorder.write(writer)
        else:
            plugins = rosbag2.StoragePlugin
            plugin = plugins.MCAP if path.suffix == ".mcap" else plugins.SQLITE3
            with rosbag2.Writer(place, version=_VERSION, storage_plugin=plugin) as writer:
                recorder.write(writer)
            if path.suffix in (".mcap", ".db3"):
                (place,) = place.glob(f"*{path.suffix}")
        shutil.move(place, path)


def write_recording(path: str | Path, robots: Sequence[RobotRecording]) -> None:
    """Write scans, odometry, tf and, where there is a gyro, Imu of each robot. Raises DataError if the path exists."""
    with _recorder(Path(path)) as recorder:
        for robot in robots:
            _record_robot(recorder, robot)


def _record_robot(recorder: _Recorder, robot: RobotRecording) -> None:
    prefix = f"{robot.namespace}/" if robot.namespace else ""
    odom, base, laser = (f"{prefix}{frame}" for frame in ("odom", "base_link", "laser"))
    scanner = robot.scanner
    recorder.transform(float(robot.times_s[0]), "/tf_static", base, laser, np.array(scanner.mount))
    for k, (time_s, pose) in enumerate(zip(robot.times_s.tolist(), robot.odometry, strict=True)):
        recorder.odometry(time_s, f"/{prefix}odom", odom, base, pose)
        recorder.transform(time_s, "/tf", odom, base, pose)
        ranges_m = np.asarray(robot.ranges_m[k], np.float32)
        if len(ranges_m):
            between_s = scanner.sweep_s / (len(ranges_m) - 1) if len(ranges_m) > 1 else 0.0
            recorder.add(
                time_s, f"/{prefix}scan", SCAN, header=recorder.header(time_s - scanner.sweep_s, laser),
                angle_min=scanner.first_rad, angle_max=scanner.first_rad + scanner.step_rad * (len(ranges_m) - 1),
                angle_increment=scanner.step_rad, time_increment=between_s, scan_time=scanner.sweep_s,
                range_min=scanner.range_min_m, range_max=scanner.range_max_m, ranges=ranges_m,
                intensities=np.zeros(0, np.float32),
            )  # fmt: skip
        if robot.turn_rates_rad_s is not None:
            vector = recorder.kind("geometry_msgs/msg/Vector3")
            recorder.add(
                time_s, f"/{prefix}imu", IMU, header=recorder.header(time_s, base), orientation=recorder.turn(0.0),
                orientation_covariance=np.concatenate([[-1.0], np.zeros(8)]),
                angular_velocity=vector(x=0.0, y=0.0, z=float(robot.turn_rates_rad_s[k])),
                angular_velocity_covariance=np.zeros(9), linear_acceleration=vector(x=0.0, y=0.0, z=9.81),
                linear_acceleration_covariance=np.zeros(9),
            )  # fmt: skip


def write_estimates(path: str | Path, robots: Sequence[RobotEstimate], grids: Mapping[str, GridMap]) -> None:
    """Write, for each robot, its path, its poses as Odometry and the transform from its map frame to odom, and the
    maps, by the names of their frames. Raises DataError if the path exists."""
    end_s = max(float(robot.times_s[-1]) for robot in robots)
    with _recorder(Path(path)) as recorder:
        for robot in robots:
            prefix = f"{robot.namespace}/" if robot.namespace else ""
            odom, base = f"{prefix}odom", f"{prefix}base_link"
            stamped = []
            corrections = compose(robot.poses, inverse(robot.logged))
            for time_s, pose, logged, correction, is_known in zip(
                robot.times_s.tolist(), robot.poses, robot.logged, corrections, robot.is_known.tolist(), strict=True
            ):
                recorder.transform(time_s, "/tf", odom, base, logged)
                if not is_known:
                    continue
                recorder.odometry(time_s, f"/{prefix}slam/odometry", robot.map_frame, base, pose)
                recorder.transform(time_s, "/tf", robot.map_frame, odom, correction)
                stamped.append(
                    recorder.kind("geometry_msgs/msg/PoseStamped")(
                        header=recorder.header(time_s, robot.map_frame), pose=recorder.pose(pose)
                    )
                )
            header = recorder.header(float(robot.times_s[-1]), robot.map_frame)
            recorder.add(float(robot.times_s[-1]), f"/{prefix}slam/path", PATH, header=header, poses=stamped)
        for frame, grid in grids.items():
            _add_grid(recorder, end_s, frame, grid)


def _add_grid(recorder: _Recorder, time_s: float, frame: str, grid: GridMap) -> None:
    """A map as ROS has it: 0 free, 100 occupied, -1 unknown; the row of the lowest y first."""
    cells = np.where(grid.log_odds > 0, 100, np.where(grid.log_odds < 0, 0, -1)).astype(np.int8)
    header = recorder.header(time_s, frame)
    info = recorder.kind("nav_msgs/msg/MapMetaData")(
        map_load_time=header.stamp, resolution=float(grid.resolution_m), width=cells.shape[1], height=cells.shape[0],
        origin=recorder.pose(np.array([*grid.origin_m, 0.0])),
    )  # fmt: skip
    recorder.add(time_s, f"/{frame}", GRID, header=header, info=info, data=cells.ravel())
