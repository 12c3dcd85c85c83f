"""All sign readings of the robots, and the signs that a group of robots knows from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of
from twc_env.records.geometry import between, compose
from twc_env.records.growing_arrays import ROOM, grown, only
from twc_env.records.messages import Keyframe
from twc_env.records.team_messages import KnownSigns

SAME_SIGN_M = 1.0
"""Readings of one text within this distance are of one sign."""
ENOUGH, ENOUGH_M = 8, 0.5
"""With this many readings of a text by one robot within ENOUGH_M, further ones are dropped, so that signs passed many
times cost no more time and memory."""
_UNKNOWN = (), (-1, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, np.int64))
"""State of a robot whose group's signs must be recomputed."""


@borrowing_kernel
def _add(rule, poses, readings, local, count, robot, node, text, ahead, left, rank, texts, places, owners):
    """Append a text that a robot read ahead and to the left of a node to the `count` readings.

    Skipped if enough readings of it are that near. Returns the new number of readings, and whether the known signs of
    its group may have changed: not if it is a known sign found by the robot itself or one before it. rank: the robot's
    place in the group, -1 if the known signs are not available; texts, places and owners as written by
    `_places_of_signs`.
    """
    enough, within_m, same_m = parts_of(rule)
    c, s = math.cos(poses[node, 2]), math.sin(poses[node, 2])
    x, y = poses[node, 0] + c * ahead - s * left, poses[node, 1] + s * ahead + c * left
    near = 0
    for k in range(count):
        if readings[k, 0] == robot and readings[k, 2] == text:
            other = poses[readings[k, 1]]
            c, s = math.cos(other[2]), math.sin(other[2])
            dx, dy = other[0] + c * local[k, 0] - s * local[k, 1] - x, other[1] + s * local[k, 0] + c * local[k, 1] - y
            near += math.hypot(dx, dy) < within_m
    if near >= enough:
        return count, rank < 0
    readings[count, 0], readings[count, 1], readings[count, 2] = robot, node, text
    local[count, 0], local[count, 1] = ahead, left
    for k in range(texts.shape[0]):
        away_m = math.sqrt((places[k, 0] - x) ** 2 + (places[k, 1] - y) ** 2)
        if texts[k] == text and owners[k] <= rank and away_m < same_m:
            return count + 1, False
    return count + 1, True


@kernel
def _places_of_signs(same_m, poses, readings, local, robots, text_count, texts, places, owners):
    """Text, position in the map and owner of each known sign, robot by robot, grouped by text.

    readings (n, 3): robot, node, text; local (n, 2): position in the frame of the node. The owner is the index in
    `robots` of the one that read it first. Returns the number of signs.
    """
    found_by, found = np.empty(readings.shape[0], np.int64), np.empty((readings.shape[0], 2))
    latest, earlier = np.full(text_count, -1), np.empty(readings.shape[0], np.int64)
    order, texts_found, count = np.empty(text_count, np.int64), 0, 0
    for a in range(robots.shape[0]):
        for k in range(readings.shape[0]):
            if readings[k, 0] != robots[a]:
                continue
            x, y, heading = poses[readings[k, 1], 0], poses[readings[k, 1], 1], poses[readings[k, 1], 2]
            c, s = math.cos(heading), math.sin(heading)
            x, y = x + c * local[k, 0] - s * local[k, 1], y + s * local[k, 0] + c * local[k, 1]
            text = readings[k, 2]
            other = latest[text]
            while other >= 0 and math.sqrt((found[other, 0] - x) ** 2 + (found[other, 1] - y) ** 2) >= same_m:
                other = earlier[other]
            if other >= 0:
                continue
            if latest[text] < 0:
                order[texts_found] = text
                texts_found += 1
            found_by[count], found[count, 0], found[count, 1] = a, x, y
            earlier[count] = latest[text]
            latest[text] = count
            count += 1
    end = 0
    for t in range(texts_found):
        first = end
        sign = latest[order[t]]
        while sign >= 0:  # from the latest to the first, then reversed
            texts[end], places[end, 0], places[end, 1] = order[t], found[sign, 0], found[sign, 1]
            owners[end] = found_by[sign]
            end += 1
            sign = earlier[sign]
        for k in range((end - first) // 2):
            i, j = first + k, end - 1 - k
            owners[i], owners[j] = owners[j], owners[i]
            for axis in range(2):
                places[i, axis], places[j, axis] = places[j, axis], places[i, axis]
    return count


@kernel
def _not_repeated(readings, places, is_gone):
    """(n,) bool: which readings at places (n, 2) are kept, see `SignReadings.sparsify`; is_gone (n,): of removed
    nodes."""
    stays = np.empty(readings.shape[0], np.bool_)
    for k in range(readings.shape[0]):
        stays[k] = not is_gone[k]
    for k in range(readings.shape[0]):
        if stays[k]:
            continue
        count, is_said = 0, False
        for j in range(readings.shape[0]):
            if readings[j, 2] != readings[k, 2] or readings[j, 0] != readings[k, 0]:
                continue
            if math.hypot(places[j, 0] - places[k, 0], places[j, 1] - places[k, 1]) < SAME_SIGN_M:
                count, is_said = count + 1, is_said or stays[j]
        stays[k] = count > 1 and not is_said
    return stays


class SignReadings(BindsAnew):
    """The readings of all robots, in order of arrival."""

    def __init__(self, robot_count: int):
        self.news = [0] * robot_count
        """Per robot, counter of readings that may change the signs of its group."""
        self._known: dict[int, tuple[Sequence[int], tuple[int, Array, Array, Array]]] = {}
        """Robots whose group's known signs are current -> the group, and the arguments of `_add`."""
        self._passed: set[int] = set()
        """Robots that read only known signs in this step; if nodes move now, these readings count as news."""
        self._numbers: dict[str, int] = {}
        """Text -> number ..."""
        self._texts: list[str] = []
        """... and the texts by number."""
        self._readings, self._places, self._count = np.zeros((ROOM, 3), np.int64), np.zeros((ROOM, 2)), 0
        """Robot, node and text of each reading; its position in the frame of its keyframe; number of readings."""
        self._run: Callable[..., int] | None = None
        """`_places_of_signs`, bound with SAME_SIGN_M."""
        self._add: Callable[..., tuple[int, bool]] | None = None
        """`_add`, bound with ENOUGH and ENOUGH_M."""

    def add(self, keyframe: Keyframe, node: int, poses: Array) -> None:
        """Add the readings of a keyframe, which is a node of the pose graph; poses (nodes, 3) of all nodes."""
        robot = keyframe.robot
        for sign in keyframe.signs:
            text = self._numbers.setdefault(sign.text, len(self._texts))
            if text == len(self._texts):
                self._texts.append(sign.text)
            if self._count == len(self._readings):
                self._readings, self._places = grown(self._readings), grown(self._places)
            held = poses, self._readings, self._places, self._count
            group, known = self._known.get(robot, _UNKNOWN)
            new = *held, robot, node, text, *sign.position_m.tolist(), *known
            if self._add is None:
                self._add = bound(_add, Lent((ENOUGH, ENOUGH_M, SAME_SIGN_M)), *new)
            self._count, is_news = self._add(*new)
            if is_news:
                self.news[robot] += 1
                for teammate in group:
                    self._known.pop(teammate, None)
            else:
                self._passed.add(robot)

    def note_move(self) -> None:
        """Record that node poses, and so the readings' positions, have changed."""
        self._known.clear()
        for robot in self._passed:
            self.news[robot] += 1
        self._passed.clear()

    def end_step(self) -> None:
        """End of a step: known signs are recomputed at most once per step."""
        self._passed.clear()

    def sparsify(self, carrier_of: Array, number_of: Array, poses: Array) -> None:
        """Remove readings of removed nodes, except the first of those that no remaining one repeats.

        A text read only once, at a removed node, is treated as a misreading, since correct texts were read there more
        often. carrier_of (nodes,): node that takes over each node's readings, itself unless removed; number_of
        (nodes,): new node numbers; poses (nodes, 3).
        """
        readings, local = self._readings[: self._count], self._places[: self._count]
        places = compose(poses[readings[:, 1]], np.pad(local, ((0, 0), (0, 1))))
        carriers = carrier_of[readings[:, 1]]
        is_gone = carriers != readings[:, 1]
        stays = _not_repeated(readings, places, is_gone)
        local[is_gone] = between(poses[carriers[is_gone]], places[is_gone])[:, :2]
        readings[:, 1] = number_of[carriers]
        numbers, texts = np.unique(readings[stays, 2], return_inverse=True)
        self._texts = [self._texts[number] for number in numbers.tolist()]
        self._numbers = {text: number for number, text in enumerate(self._texts)}
        self._count = len(texts)
        self._readings, self._places = only(readings, stays), only(local, stays)
        self._readings[: self._count, 2] = texts
        self._known.clear()

    def known(self, poses: Array, robots: Sequence[int]) -> KnownSigns:
        """The texts read by some robots of one group, each once per place; poses (nodes, 3) of all nodes."""
        readings, local = self._readings[: self._count], self._places[: self._count]
        texts, places, owners = np.empty(self._count, np.int64), np.empty((self._count, 2)), np.empty(self._count, int)
        now = poses, readings, local, np.array(robots, np.int64), len(self._numbers), texts, places, owners
        if self._run is None:
            self._run = bound(_places_of_signs, SAME_SIGN_M, *now)
        count, names = self._run(*now), self._texts
        for rank, robot in enumerate(robots):
            self._known[robot] = robots, (rank, texts[:count], places[:count], owners[:count])
        return KnownSigns([names[k] for k in texts[:count].tolist()], places[:count])
