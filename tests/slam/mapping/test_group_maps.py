from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.slam.mapping.group_maps import SIDES_MAX, Group, GroupMaps

ROBOTS = 5


@pytest.fixture
def maps(walls, scan):
    """The map of a team in a room, in which each robot took two scans."""
    random = np.random.default_rng(1)
    room = walls((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0))
    poses = random.uniform(-3.0, 3.0, (2 * ROBOTS, 3))
    scans = np.array([scan(room, pose) for pose in poses])
    graph = SimpleNamespace(
        poses=poses,
        nodes_of=lambda robots: np.flatnonzero(np.isin(np.arange(2 * ROBOTS) % ROBOTS, robots)),
        rows_of=lambda nodes: (poses[nodes], scans[nodes]),
    )
    maps = GroupMaps(EnvConfig(), graph, None, ROBOTS)
    maps.groups, maps._has_scan[:] = [Group(tuple(range(ROBOTS)), maps.groups[0].grid)], True
    return maps


def test_the_grids_of_the_sides_of_merges_used_last_are_kept(maps):
    sides = list(combinations(range(ROBOTS), 2))
    first = maps.known_grid(sides[0], 0)
    for side in sides[1:]:
        assert maps.known_grid(sides[0], 0) is first, "it is used all the time"
        maps.known_grid(side, 0)
    assert len(sides) > SIDES_MAX and list(maps._partial_maps) == [*sides[1 - SIDES_MAX :][:-1], sides[0], sides[-1]]


def test_the_grid_of_one_side_has_the_cells_of_its_scans_and_no_kinds(maps):
    grid = maps.known_grid((0, 3), 0)
    own = maps._new_grid()
    own.integrate(*maps._graph.rows_of(maps._graph.nodes_of((0, 3))))
    assert np.array_equal(grid.log_odds, own.log_odds) and grid.kinds is None
