import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.building.router_placement import place_routers


def test_more_routers_see_more_floor_and_stand_on_it():
    plan = load_map("sfw-e4")
    advice = place_routers(plan, 4)
    assert (advice.line_of_sight_share[1:] >= advice.line_of_sight_share[:-1]).all()
    assert advice.line_of_sight_share[-1] > 0.9
    assert plan.cells().is_free(advice.position_m).all()
    assert advice.dead_share < 0.05


def test_a_count_below_one_is_rejected():
    with pytest.raises(MapError, match="at least one"):
        place_routers(load_map("sfw-e1"), 0)
