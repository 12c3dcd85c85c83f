"""Robots that choose views, in a room whose door is a wall in their map and has opened since."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.exploration.macro_actions import CandidateSearch, MacroActions
from twc_env.records.messages import Belief, GridMap

CELL_M = 0.1


def shut_in() -> Belief:
    """In a mapped room of 4 x 3 m; the scan sees 3 m beyond the right wall where the door is, as it is open by now."""
    log_odds = np.zeros((50, 100), np.int16)
    log_odds[11:40, 11:50] = -40
    log_odds[[10, 40], 10:51] = log_odds[10:41, [10, 50]] = 40
    log_odds[20:30, 51:60] = -40  # seen before it shut
    pose, angles = np.array([4.0, 2.55, 0.0]), np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    to_sides = [np.abs(side / np.where(np.abs(part) > 1e-9, part, 1e-9)) for side, part in (
        (np.where(np.cos(angles) > 0.0, 1.05, 2.95), np.cos(angles)), (1.5, np.sin(angles)))]  # fmt: skip
    ranges_m = np.minimum(*to_sides)
    ranges_m[np.abs(np.angle(np.exp(1j * angles))) < 0.35] = 4.0
    return Belief(0, 0, pose, GridMap(log_odds, np.zeros(2), CELL_M), {}, ranges_m=ranges_m)


@pytest.mark.parametrize(("doors", "found"), [(0.8, True), (0.0, False)])
def test_a_robot_that_sees_through_a_wall_of_its_map_is_offered_what_lies_beyond_where_doors_move(doors, found):
    config = override(
        EnvConfig(),
        {"robots": 1, "action.kind": "frontier", "action.goals": "views", "clutter.door_share": doors},
    )
    search, belief = CandidateSearch(config), shut_in()
    search.look([belief])
    views_m = search.candidates[0].frontiers_m
    assert (len(views_m) > 0) is found
    assert not found or (views_m[:, 0] > 5.0).any(), "beyond the wall at 5 m"


def test_it_is_driven_there():
    config = override(
        EnvConfig(), {"robots": 1, "action.kind": "frontier", "action.goals": "views", "clutter.door_share": 0.8}
    )
    macro, belief = MacroActions(config), shut_in()
    macro.look([belief])
    macro.assign({"robot_0": 0}, ["robot_0"], [belief])
    speed_m_s, _ = macro.commands([belief])[0]
    assert macro._drivers.status(0) == "driving" and speed_m_s > 0.0
