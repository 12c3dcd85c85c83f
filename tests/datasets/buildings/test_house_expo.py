import csv
import json

import numpy as np
import pytest
import shapely

from tests.real_data import DATA, needs_data
from twc_env.config import EnvConfig
from twc_env.datasets.buildings.house_expo import house_expo_plan, read_house_expo
from twc_env.errors import MapError
from twc_env.world.world import World

FOLDER = DATA / "houseexpo"


def house(**changes) -> dict:
    """Two rooms of 5 x 4 m with a wall of 0.1 m and a door of 1 m between them."""
    values = {
        "id": "house",
        "room_num": 2,
        "verts": [
            [0.1, 0.1], [5.1, 0.1], [5.1, 1.6], [5.2, 1.6], [5.2, 0.1], [10.2, 0.1],
            [10.2, 4.1], [5.2, 4.1], [5.2, 2.6], [5.1, 2.6], [5.1, 4.1], [0.1, 4.1],
        ],
        "bbox": {"min": [0.1, 0.1], "max": [10.2, 4.1]},
        "room_category": {"Kitchen": [[0.1, 0.1, 5.1, 4.1]], "Living_Room": [[5.2, 0.1, 10.2, 4.1]]},
    }  # fmt: skip
    return {key: value for key, value in {**values, **changes}.items() if value is not None}


def test_the_inside_of_the_contour_is_free():
    plan = house_expo_plan(house(), "house.json")
    assert plan.name == "house"
    assert len(plan.walls_m) == 12
    assert plan.cells().is_free(np.array([[1.0, 2.0], [9.0, 2.0], [5.15, 2.1]])).all()
    assert not plan.cells().is_free(np.array([[5.15, 3.5], [-1.0, 2.0], [5.15, 1.0]])).any()


def test_a_wall_between_rooms_takes_the_whole_loss_and_the_door_none():
    plan = house_expo_plan(house(), "house.json")
    _, losses = plan.wall_index.crossing(np.array([3.0, 3.5]), np.array([[8.0, 3.5]]))
    assert losses[0] == 5.0
    _, losses = plan.wall_index.crossing(np.array([3.0, 2.1]), np.array([[8.0, 2.1]]))
    assert losses[0] == 0.0


def test_rooms_are_named_and_boxes_off_the_floor_dropped():
    categories = {
        "Kitchen": [[0.1, 0.1, 5.1, 4.1]],
        "Dining_Room": [[0.1, 0.1, 5.1, 4.1]],
        "Garage": [[-36, 0, -30, 4], [5.2, 3.6, 10.2, 9.0]],
    }
    plan = house_expo_plan(house(room_category=categories), "house.json")
    assert [room.name for room in plan.rooms] == ["Kitchen / Dining Room"]


def test_a_contour_that_touches_itself_is_read():
    spike = [*house()["verts"][:1], [3.0, 0.1], [3.0, 1.0], [3.0, 0.1], *house()["verts"][1:]]
    assert not shapely.Polygon(spike).is_valid
    plan = house_expo_plan(house(verts=spike), "house.json")
    counts, losses = plan.wall_index.crossing(np.array([2.0, 0.5]), np.array([[4.0, 0.5]]))
    assert (counts[0], losses[0]) == (2, 5.0)
    assert plan.cells().is_free(np.array([2.0, 2.0]))


def test_a_contour_that_crosses_itself_keeps_its_largest_part():
    bow_tie = [[0, 0], [6, 6], [6, 0], [2, 2], [0, 2]]
    assert not shapely.Polygon(bow_tie).is_valid
    plan = house_expo_plan(house(verts=bow_tie, room_category={}), "house.json")
    assert plan.cells().is_free(np.array([5.0, 2.0])) and plan.rooms == ()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"verts": None}, "lacks the key 'verts'"),
        ({"verts": [[0, 0], [1, 1]]}, "three or more corners"),
        ({"verts": [[0, 0], [1, float("nan")], [1, 0]]}, "not finite"),
        ({"verts": "none"}, "three or more corners"),
        ({"verts": [[0, 0], [5, 0], [9, 0]]}, "no free space inside"),
        ({"verts": [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]}, "no free space"),
        (
            {"verts": [[0, 0], [90000, 0], [90000, 90000]]},
            "spans 90000 x 90000 m, too large for one building; lengths must",
        ),
        ({"verts": [[0, 0], [1, 10**400], [1, 0]]}, "three or more corners"),
        ({"verts": [[0, 0], [1e300, 0], [1, 1]]}, "verts must be metres"),
        ({"room_category": ["Kitchen"]}, "room_category must map labels to boxes"),
        ({"room_category": {"Kitchen": 5}}, "must be a list of boxes"),
        ({"room_category": {"Kitchen": [[1, 2, 3]]}}, "must be a list of boxes"),
        ({"room_category": {"Kitchen": [[1, 2, 3, float("nan")]]}}, "must be a list of boxes"),
    ],
)
def test_faulty_plans_are_refused(changes, expected):
    with pytest.raises(MapError, match=expected) as caught:
        house_expo_plan(house(**changes), "house.json")
    assert "\n" not in str(caught.value)


def test_files_that_are_missing_or_broken_are_refused(tmp_path):
    with pytest.raises(MapError, match="cannot read the map"):
        read_house_expo(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(MapError, match="not valid JSON"):
        read_house_expo(tmp_path / "broken.json")


@needs_data
def test_every_real_plan_at_hand_loads_with_its_printed_area_and_runs():
    with (FOLDER / "INDEX.csv").open() as file:
        index = {row["id"]: row for row in csv.DictReader(file)}
    assert (len(index), sum(row["valid_polygon"] == "True" for row in index.values())) == (30, 29)
    rooms = {}
    for name, row in index.items():
        plan = read_house_expo(FOLDER / f"{name}.json")
        rooms[name[:8]] = len(plan.rooms)
        area_m2 = float(row["free_area_m2"])
        assert plan.floor_area_m2 == pytest.approx(area_m2, rel=0.01)
        outline_m = np.linalg.norm(plan.walls_m[:, 1] - plan.walls_m[:, 0], axis=1).sum()
        # Cells on the outline count as wall: half a cell along all of it.
        assert plan.cells().free.sum() * 0.01 == pytest.approx(area_m2 - 0.05 * outline_m, rel=0.03)
        world = World(EnvConfig(robots=2), plan)
        world.reset(0)
        assert all(frame.ranges_m.min() > 0.2 for frame in world.sense())
    assert rooms["003ecdd4"] > 0 == rooms["02932495"]


@needs_data
def test_the_plan_with_most_corners_is_simplified_but_not_moved():
    (path,) = FOLDER.glob("ac8116b3*.json")
    contour = shapely.LinearRing(json.loads(path.read_text())["verts"])
    plan = read_house_expo(path)
    assert len(contour.coords) > 12_000
    assert len(plan.walls_m) < 1000
    drawn = shapely.MultiLineString(list(plan.walls_m))
    assert shapely.hausdorff_distance(drawn, contour) < 0.015
