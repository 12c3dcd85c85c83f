"""What happened in an episode, step by step: truth beside the front ends' estimates. Only judges may read it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twc_env.exploration.floor_masks import FloorMasks
from twc_env.kernels import kernel

Array = NDArray


_AT_ONCE = 64
"""Steps that are put into the record together."""


class EpisodeRecord:
    """What happened so far, step by step, kept for judging."""

    def __init__(self, robots: int):
        self.count = 0
        self._poses = np.zeros((256, 3, robots, 3))
        """True pose, front-end pose and measured motion of each step; grows."""
        self._contacts = np.zeros((256, robots), bool)
        self._fresh: list[tuple[Array, Array, Array, Array]] = []
        """The latest steps, that are still to be put there."""
        self.wrong_pairs: set[tuple[int, int]] = set()
        self.floor_masks = FloorMasks()

    def append(self, true_poses: Array, odom_poses: Array, motions: Array, contacts: Array) -> None:
        """Note one step, one row per robot: true poses, front-end poses, measured motions (robots, 3), and contacts.

        The arrays are kept: nobody may change them any more.
        """
        self._fresh.append((true_poses, odom_poses, motions, contacts))
        self.count += 1
        if len(self._fresh) == _AT_ONCE:
            self._settle()

    def _settle(self) -> None:
        if not self._fresh:
            return
        begin, fresh = self.count - len(self._fresh), list(zip(*self._fresh, strict=True))
        self._fresh = []
        if self.count > len(self._poses):
            self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
            self._contacts = np.concatenate([self._contacts, np.zeros_like(self._contacts)])
        for kind in range(3):
            self._poses[begin : self.count, kind] = np.concatenate(fresh[kind]).reshape(-1, *self._poses.shape[2:])
        self._contacts[begin : self.count] = np.concatenate(fresh[3]).reshape(self.count - begin, -1)

    @property
    def contact_count(self) -> int:
        """Contacts that began after the start, summed over robots."""
        self._settle()
        contacts = self._contacts[: self.count]
        return int(np.count_nonzero(contacts[1:] & ~contacts[:-1]))

    @property
    def true_poses_now(self) -> Array:
        """(robots, 3) building frame, after the latest step."""
        return self._fresh[-1][0] if self._fresh else self._poses[self.count - 1, 0]

    @property
    def true_poses(self) -> Array:
        """(steps + 1, robots, 3) building frame."""
        self._settle()
        return self._poses[: self.count, 0]

    @property
    def odom_poses(self) -> Array:
        """(steps + 1, robots, 3) front-end estimate, each in its robot's odom frame."""
        self._settle()
        return self._poses[: self.count, 1]

    def odometry_poses(self) -> Array:
        """(steps + 1, robots, 3) dead reckoning from the true start, building frame."""
        poses = self.true_poses.copy()
        _reckon(self._poses[: self.count, 2], poses)
        return poses


@kernel
def _reckon(motions, poses):
    """Chain motions (steps, robots, 3) from poses[0], in place; motions[0] is not used."""
    for t in range(1, poses.shape[0]):
        for r in range(poses.shape[1]):
            x, y, heading = poses[t - 1, r, 0], poses[t - 1, r, 1], poses[t - 1, r, 2]
            c, s = math.cos(heading), math.sin(heading)
            poses[t, r, 0] = x + c * motions[t, r, 0] - s * motions[t, r, 1]
            poses[t, r, 1] = y + s * motions[t, r, 0] + c * motions[t, r, 1]
            poses[t, r, 2] = (heading + motions[t, r, 2] + math.pi) % (2.0 * math.pi) - math.pi
