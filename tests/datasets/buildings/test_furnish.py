import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.datasets.buildings.furnish import REPEATED, SIGN_SPACING_M, furnish, room_label
from twc_env.datasets.buildings.raster import plan_from_free
from twc_env.world.building.floorplan_check import validate
from twc_env.world.sensors.radio import RadioModel


def hall(columns: int = 300, rows: int = 100):
    free = np.zeros((rows + 10, columns + 10), bool)
    free[5:-5, 5:-5] = True
    free[40:44, 50:250:20] = False
    return plan_from_free(free, 0.1, "hall")


def test_a_furnished_plan_is_sound():
    plan = furnish(hall(), seed=4)
    assert validate(plan) is plan


def test_equal_seeds_furnish_equally_and_others_do_not():
    assert furnish(hall(), 1).digest == furnish(hall(), 1).digest
    assert furnish(hall(), 1).digest != furnish(hall(), 2).digest


def test_labels_are_unique_and_safety_signs_repeat():
    texts = [sign.text for sign in furnish(hall()).signs]
    labels = [text for text in texts if text not in REPEATED]
    assert len(labels) == len(set(labels)) >= 12
    assert all(texts.count(text) >= 3 for text in REPEATED)


def test_room_labels_stay_unique_in_large_buildings():
    labels = [room_label(i) for i in range(2000)]
    assert len(set(labels)) == 2000
    assert labels[0].startswith("A101 ")


def test_signs_keep_their_distance():
    places = np.array([sign.position_m for sign in furnish(hall()).signs])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 99 * np.eye(len(places))
    assert gaps.min() >= SIGN_SPACING_M


@pytest.mark.parametrize(("columns", "expected"), [(100, 6), (300, 12), (2000, 40)])
def test_access_points_grow_with_the_area_within_limits(columns, expected):
    plan = furnish(hall(columns))
    assert len(plan.access_points) == pytest.approx(expected, abs=1)
    macs = [mac for access_point in plan.access_points for mac in access_point.macs]
    assert len(set(macs)) == len(macs)
    assert {len(access_point.macs) for access_point in plan.access_points} == {2, 3}


def test_access_points_cover_the_floor():
    plan = furnish(hall())
    model = RadioModel(EnvConfig().radio, plan)
    cells = plan.cells(1.0)
    rows, columns = np.nonzero(cells.free)
    centres = cells.origin_m + (np.column_stack([columns, rows]) + 0.5) * cells.resolution_m
    assert all(model.mean_rssi_dbm(centre).max() > -70 for centre in centres)
    assert plan.cells().is_free(np.array([a.position_m for a in plan.access_points])).all()
