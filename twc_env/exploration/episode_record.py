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
_TRUE, _ODOM, _MOTION, _CONTACT = range(4)


class EpisodeRecord:
    """What happened so far, step by step, kept for judging."""

    def __init__(self, robots: int):
        self.count = 0
        shape = 256, robots
        self._kept = [np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, bool)]
        """True pose, front-end pose, measured motion and contact of each step; grow."""
        self._fresh: tuple[list[Array], ...] = [], [], [], []
        """The same of the latest steps, where it is still to be put there."""
        self.wrong_pairs: set[tuple[int, int]] = set()
        self.floor_masks = FloorMasks()

    def append(self, true_poses: Array, odom_poses: Array, motions: Array, contacts: Array) -> None:
        """Note one step, one row per robot: true poses, front-end poses, measured motions (robots, 3), and contacts.

        The arrays are kept: nobody may change them any more.
        """
        true, odom, motion, contact = self._fresh
        true.append(true_poses)
        odom.append(odom_poses)
        motion.append(motions)
        contact.append(contacts)
        self.count += 1
        if len(contact) == _AT_ONCE:
            for kind in range(4):
                self._settled(kind)

    def _settled(self, kind: int) -> Array:
        """(steps + 1, robots, ...) one kind of what was noted."""
        fresh, count = self._fresh[kind], self.count
        if fresh:
            if count > len(self._kept[kind]):
                self._kept[kind] = np.concatenate([self._kept[kind], np.zeros_like(self._kept[kind])])
            kept = self._kept[kind]
            kept[count - len(fresh) : count] = np.concatenate(fresh).reshape(-1, *kept.shape[1:])
            fresh.clear()
        return self._kept[kind][:count]

    @property
    def contact_count(self) -> int:
        """Contacts that began after the start, summed over robots."""
        contacts = self._settled(_CONTACT)
        return int(np.count_nonzero(contacts[1:] & ~contacts[:-1]))

    @property
    def true_poses_now(self) -> Array:
        """(robots, 3) building frame, after the latest step."""
        fresh = self._fresh[_TRUE]
        return fresh[-1] if fresh else self._kept[_TRUE][self.count - 1]

    @property
    def true_poses(self) -> Array:
        """(steps + 1, robots, 3) building frame."""
        return self._settled(_TRUE)

    @property
    def odom_poses(self) -> Array:
        """(steps + 1, robots, 3) front-end estimate, each in its robot's odom frame."""
        return self._settled(_ODOM)

    def odometry_poses(self) -> Array:
        """(steps + 1, robots, 3) dead reckoning from the true start, building frame."""
        poses = self.true_poses.copy()
        _reckon(self._settled(_MOTION), poses)
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
