"""Robots without a camera or a receiver are merged by their other cues."""

from dataclasses import replace

import numpy as np
import pytest

from twc_env import metrics
from twc_env.config import override
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.merging import merge_tests

LACKS = {"signs": {"signs": ()}, "WiFi": {"wifi": None}}


def groups_of(recorded, lack: str, robots: tuple[int, ...], **settings) -> list[tuple[int, ...]]:
    """The groups after the recorded episode without a cue of these robots; checks that no merge is wrong."""
    config, frames, true_poses = recorded
    engine = CooperativeSlam(override(config, settings), 3)
    for now in frames:
        engine.update([replace(f, **LACKS[lack]) if robot in robots else f for robot, f in enumerate(now)])
    engine.finish()
    for group in engine.team.groups:
        steps = [engine.team.keyframe_steps(r) for r in group.robots]
        true = [true_poses[at, r] for at, r in zip(steps, group.robots, strict=True)]
        estimated = [engine.team.poses_of(r) for r in group.robots]
        assert metrics.absolute_trajectory_error_m(np.concatenate(estimated), np.concatenate(true)) < 0.1
    return [group.robots for group in engine.team.groups]


@pytest.mark.parametrize("robots", [(0, 1, 2), (2,)])
@pytest.mark.parametrize("lack", LACKS)
def test_robots_without_a_cue_are_merged_by_the_other_cues(recorded, lack, robots, monkeypatch):
    monkeypatch.setattr(merge_tests, "REPEATED_MAX", 1.0)  # as if many more names had been read
    with_all_cues = groups_of(recorded, lack, ())
    assert max(map(len, with_all_cues)) > 1
    groups = groups_of(recorded, lack, robots)
    assert all(any(set(merged) <= set(group) for group in groups) for merged in with_all_cues)


def test_few_names_alone_merge_nothing(recorded):
    """One more copy of a wing has all its names; radio tells them apart where there is any."""
    assert groups_of(recorded, "WiFi", (0, 1, 2)) == [(0,), (1,), (2,)]
    assert max(map(len, groups_of(recorded, "WiFi", ()))) > 1


@pytest.mark.parametrize("lack", LACKS)
def test_algorithm_1_as_printed_never_compares_them(recorded, lack):
    rule = {"slam.place_recognition.spares_missing_cues": False}
    assert groups_of(recorded, lack, (0, 1, 2), **rule) == [(0,), (1,), (2,)]


def test_robots_that_saw_each_other_are_merged_before_they_read_a_second_common_sign(recorded):
    by_several_signs = groups_of(recorded, "signs", (), **{"slam.merging.mutual_observations_check": False})
    assert max(map(len, groups_of(recorded, "signs", ()))) > max(map(len, by_several_signs)) > 1
