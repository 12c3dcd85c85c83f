import math

import numpy as np

from twc_env.__main__ import main
from twc_env.maps import load_map
from twc_env.records.messages import GridMap
from twc_env.reproduce.walls import sfw_active
from twc_env.reproduce.walls.sfw_active import Comparison, Walked


def test_both_agents_walk_one_building_and_the_table_says_how_far(tmp_path, capsys):
    arguments = ["reproduce", "sfw-active", "--maps", "sfw-e6", "--seeds", "0", "--steps", "200", "--jobs", "1"]
    assert main([*arguments, "--cache", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert all(f"sfw-e6  0     {agent}" in told for agent in sfw_active.AGENTS)
    assert "lower bound for 100 %" in told and "path for 50% of the final IoU" in told


def test_walks_are_compared_by_the_path_length_to_reach_an_iou():
    along = Walked([0.0, 1.0, 2.0, 4.0], [0.0, 0.2, 0.4, 0.8], [1.0] * 4, [0.5] * 4, True, [0.0, 0.0])
    active = Walked([0.0, 1.0, 2.0, 3.0], [0.0, 0.4, 0.6, 0.7], [1.0] * 4, [0.5] * 4, False, [0.0, 0.0])
    pair = Comparison("m", along, active)
    assert pair.path_share(0.5) == 0.5
    assert pair.path_share(1.0) == math.inf
    assert pair.at_share(0.5) == (0.4, 0.6)
    assert sfw_active.median_share([pair.path_share(0.5)]) == (0.5, 0.5, 0.5)


def test_unknown_floor_counts_as_missed_in_the_score():
    plan = load_map("sfw-e1")
    cells = plan.cells(0.1)
    told = GridMap(np.where(cells.free, -5, 0).astype(np.int16), cells.origin_m, 0.1)
    iou, published, coverage = sfw_active.score(told, np.zeros(3), plan)
    assert iou == published == 1.0
    assert coverage < 1.0
    half = told.log_odds.copy()
    half[: len(half) // 2] = 0
    missed, published, _ = sfw_active.score(GridMap(half, cells.origin_m, 0.1), np.zeros(3), plan)
    assert missed < 0.6 < published
