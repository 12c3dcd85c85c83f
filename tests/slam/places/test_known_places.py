"""Selection of redundant keyframes of a large map."""

import numpy as np

from twc_env.slam.mapping.keyframe_sparsification import VIEWS_ENOUGH, carriers_of


def open_scans(count, reach_m=5.0):
    return np.full((count, 36), reach_m)


def carriers(poses, scans=None, robots=None, signs=None, may_go=None):
    count = len(poses)
    poses = np.array([[*place, 0.3] for place in poses])
    read = [[] for _ in poses] if signs is None else signs
    return carriers_of(
        poses, open_scans(count) if scans is None else scans, np.array(robots or [0] * count),
        np.ones(count, bool) if may_go is None else may_go, np.cumsum([len(own) for own in read]),
        np.array([place for own in read for place in own], float).reshape(-1, 2),
    ).tolist()  # fmt: skip


def test_a_keyframe_near_an_earlier_one_with_the_same_view_may_be_removed():
    assert carriers([(0, 0), (3, 0), (0.5, 0.5), (2.8, 0)]) == [-1, -1, 0, 1]
    assert carriers([(0, 0), (0.5, 0), (1.2, 0)]) == [-1, 0, -1]  # a removed keyframe cannot be a carrier
    assert carriers([(0, 0), (0.5, 0)], robots=[0, 1]) == [-1, -1]
    assert carriers([(0, 0), (0.5, 0)], may_go=np.array([True, False])) == [-1, -1]


def test_a_keyframe_behind_a_wall_is_kept():
    scans = open_scans(2)
    scans[1] = 0.2
    assert carriers([(0, 0), (0.5, 0)], scans) == [-1, -1]


def test_a_keyframe_is_kept_until_its_signs_were_read_often():
    often, sign = VIEWS_ENOUGH, [(4.0, 0.0)]
    places = [(0.01 * k, 0) for k in range(often + 2)]
    assert carriers(places, signs=[sign] * len(places)) == [-1] * often + [often - 1] * 2
    assert carriers(places, signs=[[]] + [[(4.0 * k, 0.0)] for k in range(1, often + 2)]) == [-1] * len(places)
