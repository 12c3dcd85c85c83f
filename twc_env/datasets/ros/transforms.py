"""Transforms between frames, as tf tells them: where a scanner is mounted, and odometry without an Odometry topic."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array
from scipy.spatial.transform import Rotation

BASE_FRAMES = ("base_footprint", "base_link", "base", "base_frame", "chassis", "chassis_link", "footprint")
"""Names of robot frames, without namespace."""


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Where a scanner is on its robot."""

    pose: Array
    """(3,) x, y [m] and direction of its own x axis [rad] in the robot frame."""
    is_flipped: bool
    """Whether it hangs upside down: its beams run clockwise."""
    tilt_rad: float
    """Angle between its plane and the floor."""


class Frames:
    """A tree of frames with fixed transforms."""

    def __init__(self) -> None:
        self._links: dict[str, dict[str, Array]] = {}

    def add(self, parent: str, child: str, transform: Any) -> None:
        """Note a geometry_msgs/Transform, of the child in its parent."""
        matrix = _matrix(transform)
        if matrix is not None:
            self._links.setdefault(clean(parent), {})[clean(child)] = matrix
            self._links.setdefault(clean(child), {})[clean(parent)] = np.linalg.inv(matrix)

    def between(self, target: str, source: str) -> Array | None:
        """(4, 4) transform of the source in the target; None if they are not connected."""
        found, queue = {clean(target): np.eye(4)}, deque([clean(target)])
        while queue:
            frame = queue.popleft()
            if frame == clean(source):
                return found[frame]
            for other, matrix in self._links.get(frame, {}).items():
                if other not in found:
                    found[other] = found[frame] @ matrix
                    queue.append(other)
        return None

    def mount(self, base: str, scanner: str) -> Mount | None:
        """Where the scanner's frame is in the robot's; None if tf does not say."""
        matrix = self.between(base, scanner)
        if matrix is None:
            return None
        upward = float(np.clip(matrix[2, 2], -1.0, 1.0))
        pose = np.array([matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0])])
        return Mount(pose, upward < 0.0, math.acos(abs(upward)))

    def base_of(self, scanner: str) -> str | None:
        """The robot's frame, by its name, among those connected with a scanner's."""
        known = {name.rsplit("/", 1)[-1]: name for name in self._links if self.between(name, scanner) is not None}
        return next((known[name] for name in BASE_FRAMES if name in known), None)


@dataclass(slots=True)
class MovingPairs:
    """Poses over time of frames in their parents."""

    rows: dict[tuple[str, str], list[tuple[float, float, float, float]]] = field(default_factory=dict)
    """(parent, child) -> time [s], x, y [m], heading [rad]."""

    def add(self, parent: str, child: str, time_s: float, transform: Any) -> None:
        """Note a geometry_msgs/Transform at a time."""
        place = transform.translation
        row = time_s, float(place.x), float(place.y), heading_of(transform.rotation)
        self.rows.setdefault((clean(parent), clean(child)), []).append(row)

    def odometry(self, namespace: str) -> tuple[str, str] | None:
        """The pair of an odometry frame and a robot frame, of this namespace ("" for any)."""
        pairs = [
            (parent, child) for parent, child in self.rows
            if "odom" in parent.rsplit("/", 1)[-1] and child.rsplit("/", 1)[-1] in BASE_FRAMES
        ]  # fmt: skip
        own = [pair for pair in pairs if pair[1].split("/")[:-1] == [part for part in namespace.split("/") if part]]
        return next(iter(own or pairs), None)


def clean(frame: str) -> str:
    """A name without the leading slash of old ROS 1."""
    return frame.lstrip("/")


def heading_of(rotation: Any) -> float:
    """Heading [rad] of a quaternion, which need not be normalised; NaN if it is zero."""
    x, y, z, w = (float(getattr(rotation, name)) for name in "xyzw")
    if not any((x, y, z, w)):
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _matrix(transform: Any) -> Array | None:
    """(4, 4); None for a transform that is not finite or has no rotation."""
    place = transform.translation
    quaternion = np.array([float(getattr(transform.rotation, name)) for name in "xyzw"])
    norm = float(np.linalg.norm(quaternion))
    position = np.array([float(place.x), float(place.y), float(place.z)])
    if not (math.isfinite(norm) and norm > 1e-9 and np.isfinite(position).all()):
        return None
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), position
    return matrix
