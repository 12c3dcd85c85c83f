"""Which of two frontiers a robot takes that has heard access points which another map has heard, too."""

from types import SimpleNamespace

import numpy as np
import pytest
from twc_env.agents.slam_aware.sign_seeker import SignSeeker

from twc_env.config import EnvConfig
from twc_env.records.messages import Fingerprint, MergeHypothesis, RadioTrail

PATH_M = np.array([[x, 0.0] for x in range(8)] + [[7.0, y] for y in range(1, 7)], float)
AHEAD_M = np.array([[14.0 + x, 5.0] for x in range(5)])
FRONTIERS = SimpleNamespace(
    places_m=np.array([[-3.0, 0.0], [10.0, 6.0]]), lengths_m=np.array([5.0, 6.0]), teammate_lengths_m=np.zeros((0, 2))
)
"""The second one is further, and near the other path."""


def trail(places_m, robots, hears=True):
    boxes_m = np.random.default_rng(9).uniform((-8.0, -10.0), (25.0, 15.0), (12, 2))
    apart_m = np.hypot(*(places_m[:, None] - boxes_m[None]).transpose(2, 0, 1))
    rssi_dbm = -30.0 - 38.5 * np.log10(np.maximum(apart_m, 1.0)) - (0.0 if hears else 200.0)
    heard = [Fingerprint(np.flatnonzero(row > -85.0), row[row > -85.0]) for row in rssi_dbm]
    return RadioTrail(robots, places_m, tuple(heard))


def chosen(robot, other, hears=True, hypotheses=()):
    trails = trail(PATH_M, (robot,), hears), trail(AHEAD_M, (other,), hears)
    belief = SimpleNamespace(
        robot=robot, teammates={}, radio_trails=trails, hypotheses=hypotheses, map_version=1, step=100
    )
    team = SignSeeker(EnvConfig())
    team.reset(0, ["robot_0", "robot_1"])
    return team.choose(f"robot_{robot}", {f"robot_{robot}": belief}, FRONTIERS)


@pytest.mark.parametrize(("robot", "frontier"), [(1, 1), (0, 0)])
def test_the_robot_of_the_higher_number_goes_to_where_the_other_map_is_heard(robot, frontier):
    assert chosen(robot, 1 - robot) == frontier


def test_without_what_is_heard_the_nearest_frontier_is_taken():
    assert chosen(1, 0, hears=False) == 0


def test_closures_that_agree_say_where_the_other_path_is_if_nothing_is_heard():
    said = MergeHypothesis(robots=(0,), pose_map_other=np.zeros(3), support=4, signs=(), teammates={})
    assert chosen(1, 0, hears=False, hypotheses=(said,)) == 1
