import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.records.messages import SignObservation
from twc_env.slam.places.sign_readings import SignReadings

GROUPS = ((0, 2), (1,))


def shown(signs):
    return list(signs.texts), signs.places_m.tobytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_readings_that_are_not_news_do_not_change_known_signs(keyframe, seed):
    random, readings, poses, skipped = np.random.default_rng(seed), SignReadings(3), np.zeros((60, 3)), 0
    known = {group: shown(readings.known(poses, group)) for group in GROUPS}
    for node in range(60):
        readings.end_step()
        if random.random() < 0.1:
            poses[:node] += random.normal(0.0, 0.3, (node, 3))
            readings.note_move()
        poses[node] = random.uniform(0.0, 2.5, 3)
        robot, before = int(random.integers(3)), list(readings.news)
        sign = SignObservation(str(random.choice(["exit", "lift"])), random.uniform(-0.5, 0.5, 2), 0.0)
        readings.add(keyframe(robot=robot, index=node, signs=(sign,)), node, poses)
        for group in GROUPS:
            if robot in group and readings.news != before:
                known[group] = shown(readings.known(poses, group))
            elif robot in group:
                skipped += 1
                assert shown(readings.known(poses, group)) == known[group]
    assert skipped > 5


@pytest.mark.parametrize("is_same_step", [True, False])
def test_a_reading_becomes_news_if_the_map_moves_in_the_same_step(keyframe, is_same_step):
    readings, poses = SignReadings(1), np.zeros((3, 3))
    for node in range(3):
        sign = SignObservation("exit", np.zeros(2), 0.0)
        readings.add(keyframe(robot=0, index=node, signs=(sign,)), node, poses)
        readings.known(poses, (0,))
    assert readings.news == [1]
    if not is_same_step:
        readings.end_step()
    readings.note_move()
    assert readings.news == [1 + is_same_step]
