"""The wall pieces that each ray crosses, compared with shapely."""

import numpy as np
import pytest

from twc_env.slam.walls.wall_sampler import find_crossings


def test_rays_cross_the_same_pieces_as_in_shapely():
    shapely = pytest.importorskip("shapely", reason="shapely is a development dependency")
    random = np.random.default_rng(1)
    ends, near, far = random.uniform(-5, 5, (40, 4)), random.uniform(-5, 5, (60, 2)), random.uniform(-5, 5, (60, 2))
    is_heard, first = random.random(60) < 0.8, np.zeros(41, np.int64)
    count = find_crossings(ends, near, far, is_heard, first, np.empty(0, np.int64))
    members = np.empty(count, np.int64)
    find_crossings(ends, near, far, is_heard, first, members)
    rays = [shapely.LineString(ray) for ray in np.stack([near, far], axis=1)]
    for j, piece in enumerate(shapely.linestrings(ends.reshape(-1, 2, 2))):
        expected = [i for i, ray in enumerate(rays) if is_heard[i] and piece.crosses(ray)]
        assert members[first[j] : first[j + 1]].tolist() == expected
