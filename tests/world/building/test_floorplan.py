import copy
import pickle

import numpy as np
import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.records.geometry import compose
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Room, Sign, mac_text
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.floorplan_file import floorplan_from_values, read_floorplan, write_floorplan


def square_values(**changes) -> dict:
    values = {
        "format": "twc_env/floorplan-1",
        "name": "square",
        "walls": [[0, 0, 4, 0, 5], [4, 0, 4, 4, 5], [4, 4, 0, 4, 5], [0, 4, 0, 0, 5]],
        "interior_m": [[2, 2]],
        "signs": [{"text": "EXIT", "position_m": [0, 2], "facing_rad": 0.0}],
        "access_points": [{"name": "ap", "position_m": [1, 1], "macs": ["02:00:5e:00:00:01", "02:00:5e:00:00:02"]}],
        "starts": [[2, 2, 0]],
    }
    return {key: value for key, value in {**values, **changes}.items() if value is not None}


def sign(x: float, y: float, facing_rad: float = 0.0) -> list[dict]:
    return [{"text": "EXIT", "position_m": [x, y], "facing_rad": facing_rad}]


def point(macs: list[str], name: str = "ap") -> dict:
    return {"name": name, "position_m": [1, 1], "macs": macs}


THICK_WALL = [[2, 0, 2, 4, 5], [2.2, 0, 2.2, 4, 5]]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"name": None}, ["lacks the key 'name'", "add it"]),
        ({"walls": None}, ["lacks the key 'walls'"]),
        ({"acess_points": []}, ["unknown key 'acess_points'", "did you mean 'access_points'?"]),
        ({"format": "twc_env/floorplan-9"}, ["'twc_env/floorplan-9'", "'twc_env/floorplan-1'"]),
        ({"walls": []}, ["no walls"]),
        ({"walls": [[0, 0, 4, 0]]}, ["walls must be a list of 5 numbers each", "[[0, 0, 4, 0]]"]),
        ({"walls": [[0, 0, float("nan"), 0, 5]]}, ["walls", "not finite"]),
        ({"walls": "thick"}, ["walls must be", "'thick'"]),
        ({"walls": [*square_values()["walls"], [1, 1, 1, 1, 5]]}, ["wall 4 at (1.00, 1.00) has no length", "remove"]),
        ({"walls": [[0, 0, 4, 0, -5], *square_values()["walls"][1:]]}, ["loss of -5 dB"]),
        ({"walls": square_values()["walls"][:3]}, ["not closed", "close the outer wall"]),
        ({"interior_m": []}, ["no free space", "interior_m"]),
        ({"interior_m": [[9, 9]], "signs": [], "starts": []}, ["no free space"]),
        ({"starts": [[9, 9, 0]]}, ["start 0 at (9.00, 9.00)", "outside the free space"]),
        ({"starts": [[1, 1]]}, ["starts must be a list of 3 numbers each (x, y, heading)"]),
        ({"signs": sign(2, 2)}, ["sign 'EXIT' at (2.00, 2.00) is not on a wall"]),
        ({"signs": sign(0, 2, np.pi)}, ["sign 'EXIT'", "no free floor in front"]),
        ({"signs": sign(0, 2, 45)}, ["signs[0].facing_rad must be an angle in radians; got 45", "degrees", "0.7854"]),
        ({"walls": square_values()["walls"] + THICK_WALL, "interior_m": [[1, 1], [3, 3]], "starts": [],
          "signs": sign(2.1, 2)}, ["sign 'EXIT' at (2.10, 2.00) is buried inside a wall"]),
        ({"signs": [{"text": " ", "position_m": [0, 2], "facing_rad": 0}]}, ["sign 0", "no text"]),
        ({"signs": [{"text": "\ud83d A1", "position_m": [0, 2], "facing_rad": 0}]}, ["'\\ud83d A1'", "half a letter"]),
        ({"name": "\udc00"}, ["'\\udc00'", "half a letter"]),
        ({"signs": [{"text": 7, "position_m": [0, 2], "facing_rad": 0}]}, ["signs[0].text must be a text", "7"]),
        ({"signs": [{"text": "A", "position_m": [0, 2], "facing": 0}]}, ["signs[0]", "did you mean 'facing_rad'?"]),
        ({"signs": {}}, ["signs must be a list"]),
        ({"access_points": [point(["02:00:5e:00:00:01"], "a"), point(["02:00:5e:00:00:01"], "b")]},
         ["02:00:5e:00:00:01", "'a'", "'b'", "unique"]),
        ({"access_points": [point(["2005e"])]}, ["access_points[0].macs[0]", "'2005e'", "02:00:5e"]),
        ({"access_points": [point([])]}, ["no MAC address"]),
        ({"rooms": [{"name": "hall"}]}, ["rooms[0] lacks the key 'polygon_m'"]),
    ],
)  # fmt: skip
def test_each_error_is_one_line_with_its_remedy(changes, expected):
    with pytest.raises(MapError) as caught:
        validate(floorplan_from_values(square_values(**changes), "square.json"))
    message = str(caught.value)
    assert "\n" not in message
    assert all(part in message for part in expected), message


def test_a_plan_that_is_no_object_is_rejected():
    with pytest.raises(MapError, match="must be a JSON object"):
        floorplan_from_values([1], "square.json")


def test_a_missing_or_invalid_file_is_rejected_with_its_name(tmp_path):
    with pytest.raises(MapError, match=r"cannot read the map .*none\.json"):
        read_floorplan(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text('{"name": ')
    with pytest.raises(MapError, match=r"broken\.json is not valid JSON"):
        read_floorplan(tmp_path / "broken.json")


@pytest.mark.parametrize("name", ["twin-01", "twin-02"])
def test_a_written_plan_reads_back_the_same(name, tmp_path):
    plan = load_map(name)
    write_floorplan(plan, tmp_path / "copy.json")
    again = read_floorplan(tmp_path / "copy.json")
    assert again.digest == plan.digest
    assert again.walls_m.tobytes() == plan.walls_m.tobytes()
    assert [s.text for s in again.signs] == [s.text for s in plan.signs]
    write_floorplan(again, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "copy.json").read_bytes()


def test_a_moved_plan_reads_back_with_its_home(tmp_path):
    plan = load_map("twin-01").moved([3.0, -2.0, 0.4])
    write_floorplan(plan, tmp_path / "moved.json")
    again = read_floorplan(tmp_path / "moved.json")
    assert again.home.walls_m == pytest.approx(load_map("twin-01").walls_m, abs=1e-9)
    assert again.digest == plan.digest


def test_the_digest_changes_with_every_part_of_the_plan():
    values = square_values()
    digests = {floorplan_from_values(values, "square").digest}
    for change in (
        {"name": "other"},
        {"walls": [[0, 0, 4, 0, 6], *values["walls"][1:]]},
        {"signs": sign(0, 2.1)},
        {"access_points": [point(["02:00:5e:00:00:01"])]},
        {"starts": []},
        {"interior_m": [[2, 2.5]]},
    ):
        digests.add(floorplan_from_values(square_values(**change), "square").digest)
    assert len(digests) == 7


def test_moving_keeps_the_digest_and_returns_home_exactly():
    plan = load_map("twin-01")
    moved = plan.moved([5, 6, 1.0]).moved([-2, 0, -0.3])
    assert moved.digest == plan.digest
    assert moved.home is plan
    expected = compose([-2, 0, -0.3], compose([5, 6, 1.0], plan.starts))
    assert moved.starts == pytest.approx(expected)


def test_a_motion_transforms_signs_access_points_and_rooms():
    plan = Floorplan(
        "p",
        [[[0, 0], [1, 0]]],
        [1.0],
        rooms=[Room("r", np.array([[0, 0], [1, 0], [1, 1]]))],
        signs=[Sign("s", np.array([1.0, 0.0]), 0.0)],
        access_points=[AccessPoint("a", np.array([0.0, 1.0]), (1,))],
    ).moved([10, 0, np.pi / 2])
    assert plan.signs[0].position_m == pytest.approx([10, 1])
    assert plan.signs[0].facing_rad == pytest.approx(np.pi / 2)
    assert plan.access_points[0].position_m == pytest.approx([9, 0])
    assert plan.rooms[0].polygon_m == pytest.approx(np.array([[10, 0], [10, 1], [9, 1]]))


def test_the_cells_of_a_room_have_its_area_and_walls_one_cell_thick():
    cells = floorplan_from_values(square_values(), "square").cells(0.1)
    assert cells.free.sum() == 39 * 39
    assert cells.wall.sum() == 4 * 40
    assert not (cells.free & cells.wall).any()


def test_cells_behind_a_closed_wall_are_not_free():
    walls = [*square_values()["walls"], [0, 3, 4, 3, 5]]
    cells = floorplan_from_values(square_values(walls=walls), "square").cells(0.1)
    assert cells.is_free(np.array([2.0, 2.0]))
    assert not cells.is_free(np.array([2.0, 3.5]))
    assert not cells.is_free(np.array([99.0, -99.0]))


@pytest.mark.parametrize("angle_rad", [0.0, 0.3, np.pi / 4, 1.2])
def test_a_closed_wall_is_tight_at_any_angle(angle_rad):
    cells = floorplan_from_values(square_values(), "square").moved([0.03, 0.07, angle_rad]).cells(0.1)
    assert cells.free.sum() * 0.01 == pytest.approx(15.2, abs=0.5)


def test_plans_are_read_only():
    plan = load_map("twin-01")
    with pytest.raises(ValueError, match="read-only"):
        plan.walls_m[0, 0, 0] = 9.0
    with pytest.raises(ValueError, match="read-only"):
        plan.cells().free[0, 0] = True


def square(**parts) -> Floorplan:
    """A room of 4 m, made in code."""
    corners = [[0, 0], [4, 0], [4, 4], [0, 4]]
    walls = [[corners[k - 1], corners[k]] for k in range(4)]
    return Floorplan("own", walls, [5.0] * 4, interior_m=[[2, 2]], **parts)


def test_signs_access_points_and_rooms_take_lists_as_walls_do():
    plans = []
    for kind in (list, np.array):
        signs, rooms = [Sign("A", kind([0.0, 2.0]), 0.0)], [Room("R", kind([[1, 1], [2, 1], [2, 2]]))]
        plans.append(square(signs=signs, rooms=rooms, access_points=[AccessPoint("a", kind([1, 1]), (1,))]))
    assert plans[0].digest == plans[1].digest
    assert validate(plans[0]).moved((1.0, 0.0, 0.5)).signs[0].position_m.shape == (2,)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: {"signs": [Sign("A", "here", 0.0)]}, "position_m of 'A' must be numbers; got 'here'"),
        (lambda: {"signs": [Sign(5, [0.0, 2.0], 0.0)]}, "names and sign texts are texts; got 5"),
        (lambda: {"signs": [Sign("A", [0.0, 2.0], 90.0)]}, "sign 'A': facing_rad .* radians; got 90: .* 1.5708"),
        (lambda: {"starts": [[2, 2, 180]]}, "start 0: its heading must be an angle in radians; got 180: .* 3.1416"),
        (lambda: {"access_points": [AccessPoint("a", [1, 1], ("02:00:5e:11:00:10",))]}, "a number of 48 bits"),
    ],
)
def test_mistakes_of_a_plan_made_in_code_are_named(make, expected):
    with pytest.raises(MapError, match=expected):
        validate(square(**make()))


def test_a_copied_or_pickled_plan_is_the_same_plan():
    plan = load_map("twin-01").moved([1, 2, 0.5])
    for other in (copy.deepcopy(plan), pickle.loads(pickle.dumps(plan))):
        assert other.digest == plan.digest
        assert other.home.walls_m.tobytes() == plan.home.walls_m.tobytes()
        assert np.array_equal(other.cells().free, plan.cells().free)


def test_a_building_in_the_wrong_unit_is_rejected():
    walls = [[a * 1000 for a in wall[:4]] + [5] for wall in square_values()["walls"]]
    with pytest.raises(MapError, match="too large for cells"):
        floorplan_from_values(square_values(walls=walls), "square").cells(0.1)


def test_mac_addresses_are_written_as_six_bytes():
    assert mac_text(0x02005E0000FF) == "02:00:5e:00:00:ff"
