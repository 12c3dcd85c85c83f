"""Named reward terms of one transition. Only rewards, metrics and drawing may read ground truth.

| term | value | kind |
|---|---|---|
| `coverage` | share of the floor mapped correctly by the best correctly merged group | potential |
| `merge` | (robots in that group - 1) / (robots in the team - 1) | potential |
| `localisation` | 1 - position error / 1 m, at least 0; mean over the team | potential |
| `collision` | 1 while the robot is in contact with something | event |
| `time` | 1 / `max_cycles` per time step | event |
| `bytes` | bytes sent by the team per robot and time step, / 10 kB, at most 1 | event |

Every value lies in [0, 1]. A potential pays its change, so its sum over an episode is its final value (it is 0 before
the first scan); an event pays its value. The reward is the sum of terms times the weights of the same names in
`RewardConfig`; give events negative weights. Before the last step, a map is aligned with the building to 2 cm and 1
mrad and its own cells are counted instead of the floor's, which gives the same share to within 0.001 (at most 1).
Dead reckoning (`slam.mode = "off"`, and robots of which no keyframe has been received) is aligned at the true start.

With `reward.sharing = "individual"` each robot is rewarded for its own group's coverage and merge and its own
localisation instead of the team's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import NDArray as Array

from twc_env.config import RewardConfig

POTENTIALS = ("coverage", "merge", "localisation")
TERMS = (*POTENTIALS, "collision", "time", "bytes")
_NOTHING = dict.fromkeys(TERMS, 0.0)
ERROR_MAX_M = 1.0
BYTES_MAX = 10_000.0


class Standing(NamedTuple):
    """The potentials of a team as last evaluated."""

    team: list[float]
    """Coverage, merge, localisation of the team."""
    own: list[list[float]]
    """The same for each robot: those of its group (0 if it is wrongly merged), and its own localisation."""

    @classmethod
    def nothing(cls, robots: int) -> Standing:
        """Before the first scan."""
        return cls([0.0] * 3, [[0.0] * 3 for _ in range(robots)])


class EvaluatedMap(NamedTuple):
    """A map held by some robots, compared with ground truth."""

    viewers: tuple[int, ...]
    robot_count: int
    """Robots merged in it."""
    is_right: bool
    """No pair of them is wrongly merged."""
    share: float
    """Share of the floor that it maps correctly."""


class Transition(NamedTuple):
    """One time step: the only record with both ground truth and estimates."""

    before: Standing
    after: Standing
    contacts: Array
    """(robots,) bool: touched a wall or a teammate."""
    bytes_per_robot: float
    """Sent by the team in this step."""
    step_count_max: int
    """Time steps of a whole episode."""


def terms(transition: Transition, sharing: str) -> list[dict[str, float]]:
    """The terms of each robot, by name; the names are those of the weights in RewardConfig.

    Robots with equal terms share one dict; copy it before handing it out.
    """
    before, after, contacts, bytes_per_robot, step_count_max = transition
    common, touching = _NOTHING.copy(), contacts.tolist()
    common["time"], common["bytes"] = 1.0 / step_count_max, min(bytes_per_robot / BYTES_MAX, 1.0)
    if after is not before and sharing == "team":
        common["coverage"], common["merge"], common["localisation"] = _gains(before.team, after.team)
    is_paid_apart = after is not before and sharing != "team"
    if not is_paid_apart and True not in touching:
        return [common] * len(touching)
    each = [common.copy() for _ in touching]
    if is_paid_apart:
        for own, old, new in zip(each, before.own, after.own, strict=True):
            own["coverage"], own["merge"], own["localisation"] = _gains(old, new)
    for own, touches in zip(each, touching, strict=True):
        own["collision"] = float(touches)
    return each


def quiet(uneventful: list[dict[str, float]], bytes_per_robot: float) -> list[dict[str, float]]:
    """The terms of a step with messages but no other event, from those of a step without any."""
    common = uneventful[0].copy()
    common["bytes"] = min(bytes_per_robot / BYTES_MAX, 1.0)
    return [common] * len(uneventful)


def added(sums: list[dict[str, float]], values: list[dict[str, float]]) -> list[dict[str, float]]:
    """The sum of the terms of each robot; robots that share a dict in both still do."""
    first, second = sums[0], values[0]
    if all(own is first for own in sums) and all(own is second for own in values):
        return [{name: first[name] + value for name, value in second.items()}] * len(sums)
    return [{name: own[name] + value for name, value in more.items()} for own, more in zip(sums, values, strict=True)]


def _gains(before: list[float], after: list[float]) -> tuple[float, float, float]:
    return after[0] - before[0], after[1] - before[1], after[2] - before[2]


def weights_of(config: RewardConfig) -> tuple[tuple[str, float], ...]:
    """The terms with a weight other than 0 and their weights, in the order of the terms."""
    return tuple((name, getattr(config, name)) for name in TERMS if getattr(config, name))


def weigh(values: Sequence[dict[str, float]], weights: Sequence[tuple[str, float]]) -> list[float]:
    """The reward of each robot: the weighted sum of its terms."""
    rewards: list[float] = []
    weighed, reward = None, 0.0
    for own in values:
        if own is not weighed:  # robots with equal terms share a dict
            weighed, reward = own, 0.0
            for name, weight in weights:
                reward += weight * own[name]
        rewards.append(reward)
    return rewards


def standing_of(maps: Sequence[EvaluatedMap], errors_m: Sequence[float]) -> Standing:
    """The potentials from every map that some robot holds and from the position error of each robot.

    errors_m (robots,): distance between true and estimated position, after alignment of its map.
    """
    count = len(errors_m)
    own = [[0.0, 0.0, 1.0 - min(error_m / ERROR_MAX_M, 1.0)] for error_m in errors_m]
    for viewers, robot_count, is_right, share in maps:
        if is_right:
            for viewer in viewers:
                potentials = own[viewer]
                potentials[0], potentials[1] = min(share, 1.0), (robot_count - 1) / max(count - 1, 1)
    best, right = own[0], 0.0
    for potentials in own:
        right += potentials[2]
        if potentials[0] > best[0]:
            best = potentials
    return Standing([best[0], best[1], right / count], own)
