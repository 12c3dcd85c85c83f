import numpy as np
import pytest

import twc_env
from twc_env.records.messages import Fingerprint, Keyframe
from twc_env.slam.mapping.segments import Segments

NOTHING = np.zeros(0, np.int64), np.zeros(0)


def keyframe(robot, index, begins_segment=False):
    return Keyframe(
        robot, index, index, 0.1 * index, np.zeros(3), np.zeros(3), np.eye(3), float(index), np.ones(8), (),
        Fingerprint(*NOTHING), begins_segment=begins_segment,
    )  # fmt: skip


def test_a_robot_is_its_own_segment_until_it_is_carried():
    segments = Segments(3)
    assert segments.is_whole and segments.numbered(keyframe(2, 5)).key == (2, 5)
    assert segments.robots_in((0, 2)) == (0, 2)


def test_keyframes_of_a_new_segment_are_numbered_from_zero_under_a_new_number():
    segments = Segments(3)
    assert segments.begin(keyframe(1, 7)) == 3
    assert segments.numbered(keyframe(1, 7)).key == (3, 0) and segments.numbered(keyframe(1, 9)).key == (3, 2)
    assert segments.numbered(keyframe(0, 9)).key == (0, 9)
    assert segments.owners == [0, 1, 2, 1] and segments.of(1) == [1, 3] and not segments.is_whole


def test_keyframes_of_segments_are_told_by_their_robots():
    segments = Segments(2)
    segments.add_prior()
    segments.begin(keyframe(1, 7))
    ids = np.array([[0, 3], [1, 6], [2, 5], [3, 0], [3, 2]])
    assert segments.of_robots(ids).tolist() == [[0, 3], [1, 6], [-1, 5], [1, 7], [1, 9]]


def test_a_carried_robot_is_where_its_latest_segment_is():
    segments = Segments(2)
    segments.begin(keyframe(0, 4))
    assert segments.robots_in((0, 1)) == (1,) and segments.robots_in((1, 2)) == (0, 1)
    assert segments.latest(np.array([0, 1])).tolist() == [2, 1]


@pytest.fixture(scope="module", params=["central", "peer"])
def episode(request):
    """A team of which one robot is put down elsewhere after 20 s."""
    settings = {"robots": 3, "max_cycles": 700, "failure.kidnap_step": 200, "action.kind": "frontier"}
    env = twc_env.parallel_env(map="gen:office:250:2", config={**settings, "link.topology": request.param})
    observations, _ = env.reset(seed=2)
    while env.agents:
        observations, *_ = env.step({name: int(seen["action_mask"].argmax()) for name, seen in observations.items()})
    return env


def test_the_map_of_a_carried_robot_begins_anew_and_no_map_is_wrong(episode):
    figures = episode.result().figures
    assert all(mapper.segments.owners == [0, 1, 2, 2] for mapper in episode.engine.mappers)
    assert figures["wrong_merges"] == 0 and figures["team_ate_m"] < 0.05
    assert figures["merged_robots"] == 3 and figures["wall_iou"] > 0.9


def test_the_result_says_when_it_was_carried(episode):
    (line, *_) = [line for line in episode.result().figures["lacked"] if "put down elsewhere" in line]
    assert "robot 2 was put down elsewhere at 20.0 s" in line


def test_estimated_paths_have_a_row_per_step_on_both_sides_of_the_cut(episode):
    result = episode.result()
    aligned = result.estimated_poses[:, 2, :2]
    jump_m = np.hypot(*np.diff(aligned, axis=0).T)
    true_m = np.hypot(*np.diff(result.true_poses[:, 2, :2], axis=0).T)
    assert np.argmax(jump_m) == np.argmax(true_m) == 199
    assert jump_m.max() == pytest.approx(true_m.max(), abs=0.2)


def test_keyframes_steps_and_scans_of_a_carried_robot_are_those_of_all_its_segments(episode):
    mapper = episode.engine.mapper_of(2)
    steps, scans = mapper.scans_of(2)
    assert len(steps) == len(scans) == sum(len(mapper.keyframes[segment]) for segment in mapper.segments.of(2))
    assert (np.diff(mapper.keyframe_steps(2)) > 0).all()
    assert len(mapper.poses_of(2)) == len(mapper.keyframe_steps(2))
