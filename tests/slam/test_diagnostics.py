from dataclasses import replace

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.diagnostics import SHOWN_MAX, Listening, diagnostics_of
from twc_env.slam.team import TeamMapper

MACS = (1, 2, 3, 4)
NAMES = ("A301", "A302", "A303", "B101", "B102")


@pytest.fixture
def mapper_of(keyframe):
    """A mapper with one keyframe per (robot, text, RSSI), 12 m apart, each with one sign and a fingerprint."""

    def build(*entries, beams=180):
        mapper, counts = TeamMapper(EnvConfig(), 2), [0, 0]
        for robot, name, level_dbm in entries:
            index = counts[robot]
            signs = [SignObservation(name, np.array([1.0, 0.0]), 3.0)] if name else []
            macs, levels = (MACS, np.full(4, level_dbm)) if level_dbm is not None else ((), ())
            place = (12.0 * index, 0.0, 0.0)
            ranges = np.full(beams, 3.0)
            made = keyframe(robot, index, place, 12.0 * index, ranges, signs, macs, levels)
            mapper.update(index, [replace(made, motion=np.array([12.0 * (index > 0), 0.0, 0.0]))])
            counts[robot] += 1
        return mapper

    return build


def test_missing_cues_are_reported_for_all_or_for_one_robot(mapper_of):
    nothing = diagnostics_of(mapper_of((0, None, None), (1, None, None)))
    assert nothing[:2] == ["no signs read", "no WiFi heard"]
    one = diagnostics_of(mapper_of((0, "A301", -50.0), (1, None, None)))
    assert one[:2] == ["no signs from robot 1", "no WiFi from robot 1"]


def test_robots_without_a_common_map_are_reported(mapper_of):
    lines = diagnostics_of(mapper_of((0, "A301", -50.0), (1, "B101", -60.0)))
    assert lines == ["no common map of robot 0 and robot 1: neither recognised the other's"]


@pytest.mark.parametrize(("times", "lines"), [(3, 3), (SHOWN_MAX + 5, 1)])
def test_a_robot_that_is_carried_too_often_is_told_in_one_line(keyframe, times, lines):
    """A log with beams in the wrong direction had 30 kB of them."""
    mapper = TeamMapper(EnvConfig(), 1)
    for index in range(times + 1):
        made = keyframe(0, index, np.zeros(3), float(index), np.full(180, 3.0))
        mapper.update(index, [replace(made, motion=np.zeros(3), begins_segment=index > 0)])
    told = diagnostics_of(mapper)
    carried = [line for line in told if "put down elsewhere" in line]
    assert len(carried) == lines
    if lines == 1:
        assert f"elsewhere {times} times, first at" in carried[0] and "direction of its beams" in carried[0]
        assert f"no common map of robot 0 and {times} others: neither recognised the other's" in told
    assert max(map(len, told)) < 300


@pytest.mark.parametrize(
    ("agree", "rivals", "others", "is_doubted"),
    [(5, 9, 0, True), (7, 8, 0, True), (5, 4, 5, False), (4, 0, 12, False)],
)
def test_a_map_is_doubted_if_half_as_many_closures_agree_on_another_one(mapper_of, agree, rivals, others, is_doubted):
    """Groups of closures further apart than their window, as rooms that look alike on one stretch count once."""
    mapper = mapper_of(*[(robot, None, None) for robot in (0, 1) for _ in range(40)])
    mapper._maps.merge(0, 1, np.zeros(3))
    elsewhere = [np.array([0.0, 5.0, 0.0])] * rivals + [np.array([7.0, 9.0 * k - 60.0, 0.3 * k]) for k in range(others)]
    for k, measured in enumerate([np.zeros(3)] * agree + elsewhere):
        place = 14 * (k % 3) + k // 3  # three groups of neighbours
        ends = (0, place), (1, place)
        made = LoopClosure(LoopCandidate(*ends, np.zeros(3), "twc"), measured, np.diag([1e-3, 1e-3, 1e-4]), 0.9, "")
        mapper._graph.add_closure(made)
        mapper._graph.accept(made) if k < agree else mapper._graph.refuse(made, "5.0 m from the estimate")
    line = (
        f"the map of robot 0 and robot 1 cannot be trusted: {rivals} closures between robot 0 and robot 1 agree on "
        f"another one, {agree} on this one"
    )
    assert [text for text in diagnostics_of(mapper) if "trusted" in text] == [line] * is_doubted


def test_a_device_offset_is_reported(mapper_of):
    odd = [(robot, name, -70.0 + 10.0 * robot) for name in NAMES[:3] for robot in (0, 1)]
    even = [(robot, name, -70.0 + 2.0 * robot) for name in NAMES[:3] for robot in (0, 1)]
    line = "robot 1 reads WiFi +10 dB against robot 0 where both read a name"
    assert line in diagnostics_of(mapper_of(*odd))
    assert not any("dB" in text for text in diagnostics_of(mapper_of(*even)))


def test_repeated_texts_are_counted(mapper_of):
    twice = mapper_of(*[(0, name, -50.0) for name in (*NAMES, *NAMES)])
    assert any(line == "5 of 5 sign texts occur at several places" for line in diagnostics_of(twice))
    assert not any("names" in line for line in diagnostics_of(mapper_of(*[(0, name, -50.0) for name in NAMES])))


def test_rejected_candidates_are_counted_by_reason(mapper_of):
    mapper = mapper_of((0, "A301", -50.0), (1, "B101", -60.0))
    for reason in ("overlap 0.20 < 0.65", "overlap 0.31 < 0.65", "contradiction 0.5 > 0.12", "3.1 m from the estimate"):
        candidate = LoopCandidate((0, 0), (1, 0), np.zeros(3), "twc")
        mapper.closures.append(LoopClosure(candidate, np.zeros(3), np.eye(3), 0.5, "rejected", reason))
    refused = "candidates refused: 2 by overlap, 1 by contradiction, 1 by distance from the estimate"
    assert diagnostics_of(mapper)[-1] == refused


def test_the_longest_and_the_present_link_outage_are_reported():
    listening = Listening(1, 2, 0.1)
    for step in range(300):
        heard = np.array([[True, not 50 < step < 120 and not 150 < step < 160 and step < 200]])
        listening.note(step, heard)
    assert listening.lines(0, (0, 1)) == [
        "robot 1 not heard since 19.9 s", "robot 1 not heard from 5.0 s to 12.0 s",
    ]  # fmt: skip
    assert listening.lines(0, (0,)) == []


def test_a_step_with_the_contacts_of_the_last_one_needs_no_array():
    listening, heard = Listening(1, 3, 0.1), np.array([[True, False, True]])
    listening.note(0, np.ones((1, 3), bool))
    listening.note(1, heard)
    listening.last_steps = listening.is_heard = None  # whatever uses them fails
    for step in range(2, 10):
        listening.note(step, heard if step % 2 else heard.copy())
    assert listening.last_step == 9
