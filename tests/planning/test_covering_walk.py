import numpy as np

from twc_env.planning import Terrain, covering_walk, walk_graph
from twc_env.records.messages import GridMap

RESOLUTION_M = 0.1


def terrain_of(levels):
    return Terrain(GridMap(levels, np.zeros(2), RESOLUTION_M), 0.2)


def corridor(length=100):
    levels = np.full((12, length), -10, np.int16)
    levels[[0, -1]] = levels[:, [0, -1]] = 10
    return levels


def walk_to(graph, seen, price_m):
    draws = np.random.default_rng(0).random((4000, 4))
    turns, cells = covering_walk(graph, seen, price_m, np.array([0]), draws)
    return turns, cells, graph.lengths_m[turns[:-1], turns[1:]].sum()


def test_places_lie_on_open_floor_keep_their_spacing_and_are_joined_by_open_lines():
    levels = corridor()
    levels[:9, 50] = 10  # a wall with too narrow a gap
    terrain = terrain_of(levels)
    graph = walk_graph(terrain, np.array([1.0, 0.55]), 0.3)
    assert graph.places_m[:, 0].max() < 5.0
    assert terrain.is_open(graph.places_m).all()
    apart = np.linalg.norm(graph.places_m[1:, None] - graph.places_m[1:], axis=2) + 9 * np.eye(len(graph.places_m) - 1)
    assert apart.min() >= 0.3 - 1e-9
    assert (graph.lengths_m >= np.linalg.norm(graph.places_m[:, None] - graph.places_m, axis=2) - 1e-9).all()


def test_the_walk_to_both_ends_of_a_corridor_goes_to_the_nearer_end_first():
    graph = walk_graph(terrain_of(corridor()), np.array([3.0, 0.55]), 0.3)
    x = graph.places_m[:, 0]
    seen = np.repeat(np.column_stack([x <= 0.6, x >= 9.4]), 100, axis=1)
    turns, cells, length_m = walk_to(graph, seen, 1.0)
    assert cells == 200
    assert 11.0 <= length_m <= 1.1 * (2 * 2.4 + 6.4)
    assert x[graph.way(turns)][:3].max() <= 3.0


def test_cells_whose_penalty_is_less_than_their_detour_are_left_out():
    graph = walk_graph(terrain_of(corridor()), np.array([3.0, 0.55]), 0.3)
    x = graph.places_m[:, 0]
    seen = np.column_stack([np.repeat((x <= 0.6)[:, None], 100, axis=1), np.repeat((x >= 9.4)[:, None], 10, axis=1)])
    _, cells, length_m = walk_to(graph, seen, 0.1)
    assert cells == 100
    assert length_m < 3.0
    assert walk_to(graph, seen, 0.001)[1] == 0
