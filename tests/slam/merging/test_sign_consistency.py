"""Comparison of the sign texts that two maps have at the same place."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.merging import merge_tests
from twc_env.slam.merging.sign_consistency import SignsRead, count_shared, found_apart
from twc_env.slam.team import TeamMapper

DOORS_M = 3.0


def shared(first, second):
    """`count_shared` of two maps, each a list of (text, x, y, facing)."""
    texts = {text: k for k, text in enumerate(dict.fromkeys(text for text, *_ in first + second))}
    poses = np.array([pose for _, *pose in first + second], float)
    return count_shared(
        np.array([texts[text] for text, *_ in first + second]), poses, np.arange(len(poses)) >= len(first)
    )


@pytest.mark.parametrize(
    ("text", "pose", "times", "expected"),
    [
        ("A101", (0.1, 0.0, 0.0), 1, (1, 0)),
        ("A121", (0.1, 0.0, 0.0), 1, (0, 0)),
        ("A121", (0.1, 0.0, 0.0), 2, (0, 1)),
        ("A121", (0.1, 0.0, math.pi), 2, (0, 0)),
        ("A121", (0.7, 0.0, 0.0), 2, (0, 0)),
    ],
    ids=["alike", "read once", "another", "behind the wall", "beside it"],
)
def test_texts_at_a_place_differ_only_if_both_maps_read_one_twice(text, pose, times, expected):
    assert shared([("A101", 0.0, 0.0, 0.0)] * 2, [(text, *pose)] * times) == expected


def test_one_common_reading_among_misreadings_is_enough():
    first = [("A101", 0.0, 0.0, 0.0), ("A1O1", 0.1, 0.0, 2 * math.pi), ("A1O1", 0.1, 0.0, 0.1)]
    assert shared(first, [("AI01", 0.0, 0.1, 0.0)] * 3 + [("A101", 0.0, 0.0, 0.0)]) == (1, 0)


def test_readings_are_indexed_incrementally(keyframe, scan, walls):
    room = scan(walls((-3, -2), (3, -2), (3, 2), (-3, 2)), (0.0, 0.0, 0.0))
    said = [
        [SignObservation("A101  Lab", np.array([1.0, 2.0]), 0.5), SignObservation("EXIT", np.zeros(2), math.nan)],
        [],
        [SignObservation("A101LAB", np.array([0.0, 1.0]), 0.0), SignObservation("EXIT", np.zeros(2), 1.0)],
    ]
    path = [keyframe(0, k, (0.0, 0.0, 0.0), float(k), room, signs) for k, signs in enumerate(said)]
    read = SignsRead()
    assert [part.tolist() for part in read.by(0, path[:1])] == [[0], [0], [[1.0, 2.0, 0.5]]]
    at, texts, local = read.by(0, path)
    assert (at.tolist(), texts.tolist()) == ([0, 2, 2], [0, 0, 1]) and local[2].tolist() == [0.0, 0.0, 1.0]
    read.clear()
    assert read.by(0, path[2:])[0].tolist() == [0, 0]


def test_readings_without_text_are_no_signs(keyframe):
    said = [SignObservation(text, np.array([1.0, 2.0]), 0.5) for text in ("", "  ", "EXIT")]
    assert [part.tolist() for part in SignsRead().by(0, [keyframe(signs=said)])] == [[0], [0], [[1.0, 2.0, 0.5]]]


def test_a_text_at_two_places_of_one_map_is_repeated():
    exit_, lab = 0, 1
    texts, maps = np.array([exit_, lab, exit_, lab, lab]), np.array([0, 0, 0, 1, 0])
    places_m = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 5.0], [9.0, 9.0], [3.1, 0.2]])
    assert found_apart(texts, places_m, maps).tolist() == [True, False]
    assert found_apart(texts, places_m, np.zeros(5, int)).tolist() == [True, True]


NAMES, WING_B = ["A101 LAB", "A102 MAIL", "A103 PRINT", "A104 LAB"], ["B101 LAB", "B102 MAIL", "B103 PRINT", "B104 LAB"]


@pytest.fixture
def team_along_doors(monkeypatch, keyframe, scan, walls):
    """Two robots that passed the same doors, with different texts, and the exits between them; pending closures by the
    exit signs."""

    monkeypatch.setattr(merge_tests, "REPEATED_MAX", 1.0)  # as if many more names had been read

    def passed(first, second, third=False):
        room = scan(walls((-30, -2), (30, -2), (30, 2), (-30, 2)), (0.0, 0.0, 0.0))
        team = TeamMapper(override(EnvConfig(), {"slam.merging.wifi_check": False}), 3)
        team._seeks_closures = False
        for k in range(7):
            made = []
            for robot, names in enumerate((first, second, first[::-1])[: 2 + third]):
                texts = ["EXIT" if k % 2 else names[k // 2]] * 2
                signs = [SignObservation(text, np.array([0.0, 1.0]), -math.pi / 2) for text in texts if text]
                seen = keyframe(robot, k, (DOORS_M * k, 0.0, 0.0), DOORS_M * k, room, signs)
                made.append(replace(seen, motion=np.array([DOORS_M * (k > 0), 0.0, 0.0])))
            team.update(k, made)
        for k in (1, 3, 5):
            candidate = LoopCandidate((0, k), (1, k), np.zeros(3), "text", np.array([0.0, 1.0]), text_similarity=1.0)
            team._graph.add_closure(LoopClosure(candidate, np.zeros(3), np.diag([0.01, 0.01, 0.002]), 0.9, "pending"))
        return team

    return passed


@pytest.mark.parametrize(("names", "is_merged"), [(NAMES, True), (WING_B, False), ([*NAMES[:1], *WING_B[1:]], False)])
def test_common_exit_signs_do_not_merge_maps_with_different_door_signs(team_along_doors, names, is_merged):
    assert team_along_doors(NAMES, names)._try_merge(0, 1) is is_merged


def test_maps_are_merged_where_the_robots_saw_each_other_most(team_along_doors, monkeypatch):
    team, placed, aside = team_along_doors(NAMES, NAMES), [], np.array([0.0, 0.1, 0.0])
    monkeypatch.setattr(
        team._tests, "most_observed", lambda a, b, proposal, _: replace(proposal, pose_a_b=proposal.pose_a_b + aside)
    )
    monkeypatch.setattr(team._maps, "merge", lambda a, b, pose_a_b: placed.append(pose_a_b) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        team._try_merge(0, 1)
    assert placed[0] == pytest.approx(aside)


@pytest.mark.parametrize(
    ("names", "is_merged"), [([""] * 4, False), (["A101 LAB", "", "", ""], True), (["", "EXIT", "EXIT", ""], False)]
)
def test_without_radio_repeated_texts_do_not_merge_maps(team_along_doors, names, is_merged):
    assert team_along_doors(NAMES, names)._try_merge(0, 1) is is_merged


def test_unconnected_maps_do_not_make_a_text_count_as_repeated(team_along_doors):
    """A third robot that read the common text has a separate map with another frame."""
    team = team_along_doors(NAMES, ["A101 LAB", "", "", ""], third=True)
    assert team._try_merge(0, 1)
