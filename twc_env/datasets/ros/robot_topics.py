"""Which topics of a bag are used for which robot: found by type and namespace, or chosen by the user."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from twc_env.datasets.ros.bag_file import CLOUD, IMU, ODOMETRY, SCAN, Topic, ros_name
from twc_env.errors import DataError, did_you_mean

NONE = "none"
"""Choice of no topic."""
_TRUTHS = ("truth", "gt", "ground", "mocap", "vicon", "optitrack")
"""Parts of names of topics with true poses, which a robot does not have."""
_CORRECTED = ("filtered", "slam", "amcl", "map", "laser", "fused", "corrected")
"""Parts of names of odometry that is not the wheels' own."""


@dataclass(frozen=True, slots=True)
class Wishes:
    """Topics that the user has chosen; empty: chosen by type. "none" stands for no topic."""

    scan: tuple[str, ...] = ()
    odometry: tuple[str, ...] = ()
    imu: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RobotTopics:
    """The topics of one robot."""

    namespace: tuple[str, ...]
    scan: str
    odometry: str | None
    imu: str | None

    @property
    def name(self) -> str:
        """The namespace as text; "" if there is none."""
        return "/".join(self.namespace)


def choose_topics(
    topics: Sequence[Topic], wishes: Wishes, tf_frames: Collection[str], path: object
) -> list[RobotTopics]:
    """One entry for each robot of the bag, by name. tf_frames: names of frames that move, for bags without Odometry.

    Raises DataError if there is no scan, or a chosen topic is not there.
    """
    scans, odometries, imus = (
        _candidates(topics, kind, wanted, option, path)
        for kind, wanted, option in (
            (SCAN, wishes.scan, "--scan-topic"),
            (ODOMETRY, wishes.odometry, "--odom-topic"),
            (IMU, wishes.imu, "--imu-topic"),
        )
    )
    if not scans:
        raise DataError(_no_scan(topics, path))
    tops = {topic.namespace[0] for topic in scans if topic.namespace}
    spaces = {topic.namespace[:k] for topic in (*odometries, *imus) for k in range(1, len(topic.namespace) + 1)}
    spaces |= {(top,) for top in tops if any(frame.split("/")[0] == top for frame in tf_frames if "/" in frame)}
    robots: dict[tuple[str, ...], list[Topic]] = {}
    for topic in scans:
        own = [space for space in spaces if topic.namespace[: len(space)] == space]
        robots.setdefault(max(own, key=len, default=()), []).append(topic)
    if wishes.scan and len(robots) == 1 and len(wishes.scan) > 1:
        raise DataError(f"{path}: {' and '.join(wishes.scan)} are of one robot; choose one by --scan-topic")
    found = []
    for space, own_scans in sorted(robots.items()):
        others = [other for other in robots if other != space and len(other) >= len(space)]
        found.append(
            RobotTopics(
                space,
                _most(own_scans),
                _best(_in(space, odometries, others), bool(wishes.odometry)),
                _best(_in(space, imus, others), bool(wishes.imu)),
            )
        )
    return found


def _candidates(topics: Iterable[Topic], kind: str, wanted: Sequence[str], option: str, path: object) -> list[Topic]:
    """Topics of a type that hold messages; of chosen ones those only."""
    typed = [topic for topic in topics if topic.kind == kind and topic.count > 0]
    if not wanted:
        return typed
    names = {topic.name: topic for topic in typed}
    for name in wanted:
        if name != NONE and name not in names:
            known = ", ".join(names) or "none"
            raise DataError(
                f"{path} has no topic {name!r} of {ros_name(kind)} for {option}; there are: {known}"
                f"{did_you_mean(name, names)}"
            )
    return [names[name] for name in wanted if name != NONE]


def _in(space: tuple[str, ...], topics: Iterable[Topic], others: Sequence[tuple[str, ...]]) -> list[Topic]:
    """Topics in a namespace, but not in one of these others."""
    return [
        topic for topic in topics
        if topic.namespace[: len(space)] == space and not any(topic.namespace[: len(o)] == o for o in others)
    ]  # fmt: skip


def _most(topics: Sequence[Topic]) -> str:
    return max(topics, key=lambda topic: topic.count).name


def _best(topics: Sequence[Topic], is_chosen: bool) -> str | None:
    """The robot's own measurement: never the truth, and rather wheels than what another SLAM has corrected."""
    usable = [t for t in topics if is_chosen or not any(word in t.name.lower() for word in _TRUTHS)]
    if not usable:
        return None
    return min(usable, key=lambda t: (any(word in t.name.lower() for word in _CORRECTED), -t.count, t.name)).name


def _no_scan(topics: Sequence[Topic], path: object) -> str:
    kinds = sorted({ros_name(topic.kind) for topic in topics if topic.count})
    if any(topic.kind == CLOUD for topic in topics):
        return (
            f"{path} holds 3D clouds ({ros_name(CLOUD)}) and no {ros_name(SCAN)}: cut a level slice out of them with "
            "ROS's pointcloud_to_laserscan, and record its topic"
        )
    return f"{path} has no topic of {ros_name(SCAN)} with messages, but {', '.join(kinds) or 'nothing'}; record one"
