import importlib.util
import math
import os

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None and "CI" not in os.environ,
    reason="needs stable-baselines3: pip install 'twc_env[train]'",
)

SLOTS = 3
CHOICES = SLOTS + 3


def seen_from(poses, places_m, merged=True):
    """Observations of two robots at poses (2, 3) with the same choices at positions (SLOTS, 2) in the map frame."""
    rows = {
        "pose": np.zeros((2, 8), np.float32),
        "team": np.zeros((2, 1, 5), np.float32),
        "frontiers": np.zeros((2, SLOTS, 6), np.float32),
        "action_mask": np.ones((2, CHOICES), np.int8),
    }
    for robot, (x, y, heading) in enumerate(poses):
        rows["pose"][robot, :4] = x, y, math.cos(heading), math.sin(heading)
        for slot, place in enumerate(places_m):
            rows["frontiers"][robot, slot, :3] = 1.0, *polar(place, (x, y, heading))
        if merged:
            teammate = poses[1 - robot]
            turn = math.remainder(teammate[2] - heading, 2 * math.pi)
            bearing, share = polar(teammate[:2], (x, y, heading))
            rows["team"][robot, 0, :4] = 1.0, bearing, share, turn / math.pi
    return rows


def polar(place, pose):
    away = math.dist(place, pose[:2])
    bearing = math.atan2(place[1] - pose[1], place[0] - pose[0]) - pose[2]
    return math.remainder(bearing, 2 * math.pi) / math.pi, away / (away + 10.0)


PLACES_M = np.array([[2.0, 1.0], [2.0, 5.0], [-6.0, 0.0]])
POSES = ((0.5, 1.0, 2.0), (-3.0, 4.0, -2.5))
STAY = CHOICES - 1


def notes_after(actions, **seen):
    from twc_env.training.team_notes import TeamNotes

    notes = TeamNotes(1, 2, 100)
    before = seen_from(POSES, PLACES_M, **seen)
    notes.beside(before)
    notes.note_choices(before, np.array(actions))
    return notes


def test_the_goals_block_has_the_closeness_of_choices_to_own_and_teammate_goals_after_motion():
    notes = notes_after([0, 2])
    moved = ((1.5, 0.2, -1.0), (-4.5, 1.0, 0.7))
    goals = notes.beside(seen_from(moved, PLACES_M))["goals"]
    near = [[2.0 / (2.0 + math.dist(place, goal)) for place in PLACES_M] for goal in (PLACES_M[0], PLACES_M[2])]
    assert goals[0] == pytest.approx(np.array(near).T, abs=1e-5)
    assert goals[1] == pytest.approx(np.array(near[::-1]).T, abs=1e-5)


def test_robots_of_different_groups_do_not_share_goals():
    goals = notes_after([0, 2], merged=False).beside(seen_from(POSES, PLACES_M, merged=False))["goals"]
    assert goals[0, 0, 0] == pytest.approx(1.0, abs=1e-5)
    assert (goals[:, :, 1] == 0.0).all()


def test_staying_clears_the_goal_and_busy_robots_keep_it():
    notes = notes_after([0, 2])
    seen = seen_from(POSES, PLACES_M)
    seen["action_mask"][1, :STAY] = 0
    notes.note_choices(seen, np.array([STAY, STAY]))
    goals = notes.beside(seen)["goals"]
    assert (goals[0, :, 0] == 0.0).all()
    assert goals[0, 2, 1] == pytest.approx(1.0, abs=1e-5)


def test_goals_are_cleared_when_maps_merge_and_when_the_episode_ends():
    merged = notes_after([0, 2], merged=False).beside(seen_from(POSES, PLACES_M))
    assert (merged["goals"] == 0.0).all()
    notes = notes_after([0, 2])
    notes.note_outcome(40, np.array([0.25, 0.25]))
    going = notes.beside(seen_from(POSES, PLACES_M))
    assert going["clock"].ravel().tolist() == pytest.approx([0.6, 0.6])
    assert going["gained"].ravel().tolist() == [0.25, 0.25]
    notes.note_outcome(60, 0.5, np.array([True, True]))
    anew = notes.beside(seen_from(POSES, PLACES_M))
    assert (anew["clock"] == 1.0).all() and (anew["gained"] == 0.0).all() and (anew["goals"] == 0.0).all()


def test_empty_slots_have_zero_closeness():
    seen = seen_from(POSES, PLACES_M)
    seen["frontiers"][:, 1] = 0.0
    assert (notes_after([0, 2]).beside(seen)["goals"][:, 1] == 0.0).all()
