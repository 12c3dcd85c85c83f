"""How far places are from what robots of another map have seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.planning.test_radio_whereabouts import AHEAD_M, PATH_M, trail
from twc_env.planning import OtherMaps, whereabouts
from twc_env.records.messages import MergeHypothesis

PLACES_M = np.array([[-3.0, 0.0], [10.0, 6.0]])
NOWHERE_M = np.zeros((0, 2))


def belief(robot, others, hypotheses=(), step=100, **more):
    told = trail(PATH_M, (robot,)), *(trail(places_m, (other,), seed=1) for other, places_m in others)
    values = {"teammates": {}, "map_version": 1, **more}
    return SimpleNamespace(robot=robot, radio_trails=told, hypotheses=hypotheses, step=step, **values)


def test_distances_are_those_to_where_the_robots_of_a_lower_number_are_likely_to_have_been():
    mine = belief(2, [(1, AHEAD_M)])
    expected = whereabouts(*mine.radio_trails).distance_m(PLACES_M)
    assert OtherMaps(0.1).away_m(mine, PLACES_M, NOWHERE_M) == pytest.approx(expected)
    assert expected[1] < expected[0]


@pytest.mark.parametrize(
    "mine", [belief(0, [(1, AHEAD_M)]), belief(2, []), belief(2, [(1, AHEAD_M)], teammates={0: np.zeros(3)})]
)
def test_who_has_the_lowest_number_of_both_maps_or_is_alone_seeks_nobody(mine):
    assert not OtherMaps(0.1).away_m(mine, PLACES_M, NOWHERE_M).any()


def test_of_several_maps_the_nearest_counts():
    far_m = AHEAD_M + [0.0, -60.0]
    one, both = (belief(2, others) for others in ([(1, AHEAD_M)], [(0, far_m), (1, AHEAD_M)]))
    away_m = [OtherMaps(0.1).away_m(each, PLACES_M, NOWHERE_M)[1] for each in (one, both)]
    assert away_m[0] == away_m[1]


def test_closures_that_agree_weigh_more_the_more_they_are_until_the_robot_has_been_there():
    there_m = AHEAD_M + [0.0, 10.0]
    said = MergeHypothesis(robots=(1,), pose_map_other=np.array([0.0, 10.0, 0.0]), support=1, signs=(), teammates={})
    by_radio = OtherMaps(0.1).away_m(belief(2, [(1, AHEAD_M)]), PLACES_M, NOWHERE_M)
    nearest_m = np.hypot(*(PLACES_M[:, None] - there_m[None]).T).min(axis=0)
    for support, share in ((1, 0.5), (3, 0.75)):
        mine = belief(2, [(1, AHEAD_M)], (replace(said, support=support),))
        away_m = OtherMaps(0.1).away_m(mine, PLACES_M, NOWHERE_M)
        assert away_m == pytest.approx((1.0 - share) * by_radio + share * nearest_m)
        assert OtherMaps(0.1).away_m(mine, PLACES_M, there_m) == pytest.approx(by_radio)


def test_the_others_are_located_anew_every_three_seconds_and_in_another_map():
    others = OtherMaps(0.1)
    first = others.away_m(belief(2, [(1, AHEAD_M)]), PLACES_M, NOWHERE_M)
    moved = [(1, PATH_M)]
    assert np.array_equal(others.away_m(belief(2, moved, step=129), PLACES_M, NOWHERE_M), first)
    again = others.away_m(belief(2, moved, step=130), PLACES_M, NOWHERE_M)
    assert not np.array_equal(again, first)
    assert not np.array_equal(
        others.away_m(belief(2, [(1, AHEAD_M)], step=131, map_version=2), PLACES_M, NOWHERE_M), again
    )
