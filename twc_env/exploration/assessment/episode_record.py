"""Record of an episode per time step: ground truth and the front ends' estimates. For evaluation only."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.assessment.map_evaluation import MapEvaluators
from twc_env.kernels.compiled import BindsAnew, borrowing_kernel, bound, kernel, rebound
from twc_env.records.growing_arrays import grown


class EpisodeRecord(BindsAnew):
    """Poses, motions and contacts of all time steps so far, for evaluation."""

    def __init__(self, robots: int):
        self.count = 0
        shape = 256, robots
        self._kept: tuple[Array, ...] = (
            np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape, bool)
        )  # fmt: skip
        """(capacity, robots, ...) true pose, front-end pose, measured motion and contact of each step; enlarged on
        demand."""
        self._run: Callable[..., None] | None = None
        """`_note` bound to these arrays."""
        self.wrong_pairs: set[tuple[int, int]] = set()
        """Pairs of robots that were wrongly merged at a step at which the rewards were evaluated."""
        self.map_evaluators = MapEvaluators()

    def append(self, true_poses: Array, odom_poses: Array, motions: Array, contacts: Array) -> None:
        """Append one step: true poses, front-end poses, measured motions (robots, 3); contacts (robots,) bool."""
        now = self.count, true_poses, odom_poses, motions, contacts
        if self.count == len(self._kept[0]):
            self._kept = tuple([grown(kept) for kept in self._kept])
            self._run = rebound(self._run, self._kept)
        if self._run is None:
            self._run = bound(_note, self._kept, *now)
        self._run(*now)
        self.count += 1

    @property
    def bytes_held(self) -> int:
        """Size of the recorded steps [bytes]: proportional to their number."""
        return sum(kept[: self.count].nbytes for kept in self._kept)

    @property
    def contact_count(self) -> int:
        """Number of contacts that began after the start, summed over robots."""
        contacts = self._kept[3][: self.count]
        return int(np.count_nonzero(contacts[1:] & ~contacts[:-1]))

    @property
    def true_poses(self) -> Array:
        """(steps + 1, robots, 3) in the building frame."""
        return self._kept[0][: self.count]

    @property
    def odom_poses(self) -> Array:
        """(steps + 1, robots, 3) front-end estimates, each in its robot's odom frame."""
        return self._kept[1][: self.count]

    def odometry_poses(self) -> Array:
        """(steps + 1, robots, 3) dead reckoning from the true start poses, in the building frame."""
        poses = self.true_poses.copy()
        _reckon(self._kept[2][: self.count], poses)
        return poses


@borrowing_kernel
def _note(kept, step, true_poses, odom_poses, motions, contacts):
    """Write one step to the arrays of the record."""
    true, odom, motion, contact = kept
    for robot in range(contacts.shape[0]):
        for axis in range(3):
            true[step, robot, axis], odom[step, robot, axis] = true_poses[robot, axis], odom_poses[robot, axis]
            motion[step, robot, axis] = motions[robot, axis]
        contact[step, robot] = contacts[robot]


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
