"""One bag of ROS 1 (.bag) or ROS 2 (a folder, .db3 or .mcap): its topics and their messages.

Messages are decoded by the standard definitions of their types, not by those in the bag, so that a bag cannot bring
code of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from twc_env.errors import DataError, TwcError
from twc_env.records.input_file import input_path

SCAN, ODOMETRY, IMU = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
CLOUD = "sensor_msgs/msg/PointCloud2"
READ_KINDS = (SCAN, ODOMETRY, IMU, *TRANSFORMS)
"""Types of messages that are decoded."""
SUFFIXES = (".bag", ".db3", ".mcap")
_NS_PER_S = 1e9
_DEPTH_MAX = 100
"""Depth of lists in metadata.yaml; bags have 4."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag."""

    name: str
    kind: str
    """Type of its messages, such as `SCAN`."""
    count: int

    @property
    def namespace(self) -> tuple[str, ...]:
        """Names before the last one: ("robot_0",) of /robot_0/scan."""
        return tuple(part for part in self.name.split("/") if part)[:-1]


def is_bag(path: str | Path) -> bool:
    """Whether a path is named like a bag, or is a folder that holds one."""
    path = Path(path)
    if not path.is_dir():
        return path.suffix in SUFFIXES
    return (path / "metadata.yaml").is_file() or any(path.glob("*.db3")) or any(path.glob("*.mcap"))


class Bag:
    """An open bag; `opened` opens one."""

    def __init__(self, path: Path, reader: Any):
        self._path, self._reader = path, reader
        self._store = typestore(is_ros2=reader.is2)
        counts: dict[tuple[str, str], int] = {}
        for link in reader.connections:
            key = link.topic, link.msgtype
            counts[key] = counts.get(key, 0) + link.msgcount
        self.topics = [Topic(*key, count) for key, count in sorted(counts.items())]
        """By name."""

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last."""
        return max(float(self._reader.duration) / _NS_PER_S, 0.0)

    def messages(self, topics: Collection[str], kinds: Collection[str]) -> Iterator[tuple[str, float, Any]]:
        """Name of the topic, time of reception [s] and message, for all messages of these topics and types, which are
        among `READ_KINDS`; a topic may have several. Raises DataError for a message that cannot be decoded."""
        links = [link for link in self._reader.connections if link.topic in topics and link.msgtype in kinds]
        if not links:
            return
        decode = self._store.deserialize_cdr if self._reader.is2 else self._store.deserialize_ros1
        with _one_line(self._path):
            for link, received_ns, raw in self._reader.messages(links):
                try:
                    message = decode(raw, link.msgtype)
                except Exception as error:  # bytes of any kind end in almost any exception
                    told = f"{self._path}: a message of {link.topic} is no {ros_name(link.msgtype)}: {_short(error)}"
                    raise DataError(f"{told}; record or convert the bag again") from error
                yield link.topic, received_ns / _NS_PER_S, message


@contextmanager
def opened(path: str | Path) -> Iterator[Bag]:
    """Open a bag. Raises DataError if it is none, is damaged, or the package `rosbags` is not installed."""
    path = input_path(path)
    try:
        from rosbags.highlevel import AnyReader
    except ImportError as error:
        raise DataError(f"{path} is a bag of ROS: reading it needs `pip install 'twc_env[ros]'`") from error
    place = _place(path)
    with _one_line(path):
        reader = AnyReader([place], default_typestore=typestore(is_ros2=place.suffix != ".bag"))
        reader.open()
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _place(path: Path) -> Path:
    """What to give to the reader: the path itself or, for a folder without metadata.yaml, the one file in it."""
    if path.is_dir() and (path / "metadata.yaml").is_file():
        _check_depth(path / "metadata.yaml")
        return path
    if not path.is_dir():
        return path
    files = sorted([*path.glob("*.db3"), *path.glob("*.mcap")])
    if len(files) == 1:
        return input_path(files[0])
    raise DataError(f"{path} has {len(files)} bag files and no metadata.yaml: run `ros2 bag reindex {path}`")


def _check_depth(metadata: Path) -> None:
    """Raise DataError for lists within lists, whose reading takes a time that grows with the square of their depth."""
    depth = deepest = 0
    for byte in metadata.read_bytes():
        depth += (byte in b"[{") - (byte in b"]}")
        deepest = max(deepest, depth)
    if deepest > _DEPTH_MAX:
        raise DataError(f"{metadata} nests its lists too deeply; run `ros2 bag reindex {metadata.parent}`")


@contextmanager
def _one_line(path: Path) -> Iterator[None]:
    """Turn whatever a damaged bag raises into a DataError."""
    try:
        yield
    except TwcError:
        raise
    except FileNotFoundError as error:
        raise DataError(f"there is no bag {path}: {_short(error)}; check the path") from error
    except Exception as error:
        remedy = "record or copy it again (`rosbag reindex`, `ros2 bag reindex` and `mcap recover` repair some)"
        raise DataError(f"cannot read the bag {path}: {_short(error)}; {remedy}") from error


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:160].rstrip(".") or type(error).__name__


def ros_name(kind: str) -> str:
    """Name of a type as people write it: sensor_msgs/LaserScan."""
    return kind.replace("/msg/", "/")


@lru_cache(maxsize=2)
def typestore(is_ros2: bool) -> Any:
    """Standard definitions of ROS 2 (Humble; those that are read are equal in all versions) or ROS 1 (Noetic)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if is_ros2:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORMS:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", kind))
    return store
