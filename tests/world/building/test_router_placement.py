import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.building.router_placement import place_routers, share_in_sight


def test_more_routers_see_more_floor_and_stand_on_it():
    plan = load_map("sfw-e4")
    advised_m = place_routers(plan, 4)
    shares = [share_in_sight(plan, advised_m[:count]) for count in range(1, 5)]
    assert shares == sorted(shares) and shares[-1] > 0.9
    assert plan.cells().is_free(advised_m).all()


def test_a_count_below_one_is_rejected():
    with pytest.raises(MapError, match="at least one"):
        place_routers(load_map("sfw-e1"), 0)
