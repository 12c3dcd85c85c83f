import numpy as np
import pytest
import shapely
from scipy import ndimage

from twc_env.datasets.buildings.outline import outer_ring, simplified_ring


@pytest.mark.parametrize("seed", range(8))
def test_the_ring_around_a_patch_encloses_its_cells_and_holes(seed):
    random = np.random.default_rng(seed)
    labels, _ = ndimage.label(random.random((12, 15)) < 0.62)
    patch = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
    ring = shapely.Polygon(outer_ring(patch))
    # What is joined to the outside over a corner lies outside too.
    filled = ndimage.binary_fill_holes(patch, structure=np.ones((3, 3)))
    assert ring.exterior.is_ccw
    assert ring.area == filled.sum()
    assert all(ring.contains(shapely.Point(c + 0.5, r + 0.5)) for r, c in np.argwhere(filled))


def test_simplifying_keeps_true_corners_and_drops_points_on_straight_walls():
    ring = np.array([[0, 0], [1, 0.004], [2, 0], [2, 0], [4, 0], [4, 3], [2, 3.003], [0, 3]])
    assert simplified_ring(ring, 0.01).tolist() == [[0, 0], [4, 0], [4, 3], [0, 3]]


def test_simplifying_stays_within_the_tolerance():
    random = np.random.default_rng(0)
    angles = np.sort(random.uniform(0, 2 * np.pi, 400))
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * (3 + 0.03 * random.standard_normal(400))[:, None]
    kept = shapely.LinearRing(simplified_ring(ring, 0.05))
    assert len(kept.coords) < 300
    assert max(kept.distance(shapely.Point(p)) for p in ring) <= 0.05 + 1e-9
