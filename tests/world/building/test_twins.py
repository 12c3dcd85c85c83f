import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.maps import load_map, map_names
from twc_env.world.building.generate import check_reachable
from twc_env.world.world import World


@pytest.mark.parametrize(
    ("name", "area_m2", "macs"),
    [("radio-sutd-indoor", 5000, 1921), ("radio-ntu", 5100, 1046), ("radio-sutd-outdoor", 75_000, 4488)],
)
def test_radio_twins_have_the_printed_area_and_number_of_transmitters(name, area_m2, macs):
    plan = load_map(name)
    x0, y0, x1, y1 = plan.bounds_m
    assert (x1 - x0) * (y1 - y0) == pytest.approx(area_m2, rel=0.001)
    assert sum(len(a.macs) for a in plan.access_points) == macs
    assert plan.name == name and name in map_names()
    World(EnvConfig(), plan).reset(0)


@pytest.mark.parametrize(
    ("name", "area_m2", "routers"),
    [("e1", 15.7, 1), ("e2", 34.2, 1), ("e3", 42.5, 1), ("e4", 51.5, 1), ("e5", 42.5, 2), ("e6", 51.5, 2)],
)
def test_k_visibility_areas_have_the_printed_size_and_routers(name, area_m2, routers):
    plan = check_reachable(load_map(f"sfw-{name}"))
    assert plan.floor_area_m2 == pytest.approx(area_m2, rel=0.01)
    assert len(plan.access_points) == routers
    assert all(len(a.macs) == 2 for a in plan.access_points)
    # Two walls or more lie between the first router and some part of the floor.
    cells = plan.cells()
    rows, columns = np.nonzero(cells.free)
    points = cells.origin_m + (np.column_stack([columns, rows]) + 0.5) * cells.resolution_m
    counts, _ = plan.wall_index.crossing(plan.access_points[0].position_m, points)
    assert counts.min() == 0 and counts.max() >= (1 if name == "e1" else 2)


@pytest.mark.parametrize(("one", "two"), [("sfw-e3", "sfw-e5"), ("sfw-e4", "sfw-e6")])
def test_plans_of_one_site_differ_by_their_routers_only(one, two):
    a, b = load_map(one), load_map(two)
    assert np.array_equal(a.walls_m, b.walls_m)
    assert a.access_points[0].macs == b.access_points[0].macs
    assert len(b.access_points) == len(a.access_points) + 1
