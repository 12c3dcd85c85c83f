"""Which candidates are worth a look."""

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.team import TeamMapper

MACS, LEVELS_DBM = (1, 2, 3, 4), np.full(4, -50.0)
LOOSE, FIRM = np.diag([4.0, 0.001, 0.001]), np.diag([0.001, 0.001, 0.001])


@pytest.mark.parametrize(("covariance", "is_compared"), [(LOOSE, True), (FIRM, False)])
def test_signs_are_compared_along_a_corridor_although_its_walls_were_met_again(
    keyframe, scan, walls, covariance, is_compared
):
    corridor, mapper = walls((-40.0, -1.0), (40.0, -1.0), (40.0, 1.0), (-40.0, 1.0)), TeamMapper(EnvConfig(), 2)

    def made(robot, index, x, is_by_sign):
        signs = [SignObservation("LIBRARY", np.array([1.0 - x, 1.0]), -np.pi / 2)] if is_by_sign else []
        return keyframe(robot, index, (x, 0.0, 0.0), x, scan(corridor, (x, 0.0, 0.0)), signs, MACS, LEVELS_DBM)

    mapper.give_starts(np.zeros((2, 3)))
    mapper.update(0, [made(0, 0, 0.0, True), made(1, 0, 0.0, False)])
    near = LoopCandidate((0, 0), (1, 0), np.zeros(3), "proximity")
    mapper._search.note_tie(LoopClosure(near, np.zeros(3), covariance, 1.0, "accepted"))
    mapper.update(1, [made(1, 1, 1.0, True)])
    assert [closure.candidate.recogniser for closure in mapper.closures] == ["twc"] * is_compared
