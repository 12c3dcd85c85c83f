"""Pending closures are found by the two groups that they connect."""

import numpy as np

from twc_env.records.messages import LoopCandidate, LoopClosure
from twc_env.slam.mapping.pending_closures import WaitingClosures


def waits(number: int, target: int, source: int) -> LoopClosure:
    candidate = LoopCandidate((target, 0), (source, 0), np.zeros(3), "wifi")
    closure = LoopClosure(candidate, np.zeros(3), np.eye(3), 1.0, "pending")
    closure.number = number
    return closure


def test_pending_closures_between_two_groups_are_in_the_order_of_their_numbers():
    waiting = WaitingClosures(waits(*what) for what in ((3, 2, 0), (0, 0, 1), (2, 1, 2), (1, 3, 0), (4, 0, 2)))
    waiting.add([waits(5, 1, 3)])
    assert [closure.number for closure in waiting.between((0, 1), (2, 3))] == [1, 2, 3, 4, 5]
    assert [closure.number for closure in waiting.between((2,), (0,))] == [3, 4]
    assert waiting.between((2,), (3,)) == []


def test_closures_can_be_removed_from_and_added_again_to_the_pending_ones():
    first, second = waits(0, 0, 1), waits(1, 0, 1)
    waiting = WaitingClosures([first, second])
    first.status = second.status = "rejected"
    assert waiting.between((0,), (1,)) == [] and waiting.pairs() == []
    first.status = "pending"
    waiting.add([first])
    assert waiting.between((1,), (0,)) == [first] and waiting.pairs() == [(0, 1)]
