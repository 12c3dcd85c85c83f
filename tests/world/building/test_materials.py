import dataclasses
import json

import numpy as np
import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.floorplan_file import floorplan_from_values, read_floorplan, write_floorplan
from twc_env.world.building.materials import MATERIALS


def values() -> dict:
    walls = [[0, 0, 4, 0, 5], [4, 0, 4, 4, 5], [4, 4, 0, 4, 5], [0, 4, 0, 0, 5]]
    return {"format": "twc_env/floorplan-1", "name": "hut", "walls": walls, "interior_m": [[2, 2]]}


def test_material_losses_increase_with_frequency():
    for material in MATERIALS.values():
        low, high, cell = material.losses_db
        assert high > low > cell > 0


def test_materials_and_storeys_are_kept_by_writing_and_moving(tmp_path):
    access_point = {"name": "a", "position_m": [1, 1], "macs": ["02:00:5e:00:00:01"], "floor": 2}
    plan = floorplan_from_values({**values(), "materials": {"glass": [1, 3]}, "access_points": [access_point]}, "hut")
    assert plan.wall_materials == ("", "glass", "", "glass")
    write_floorplan(plan, tmp_path / "hut.json")
    again = read_floorplan(tmp_path / "hut.json")
    assert again.wall_materials == plan.wall_materials
    assert again.access_points[0].floor == 2
    assert again.digest == plan.digest != floorplan_from_values(values(), "hut").digest
    moved = plan.moved([3.0, 1.0, 0.5])
    assert moved.wall_materials == plan.wall_materials
    assert moved.access_points[0].floor == 2


def test_plans_without_materials_write_none(tmp_path):
    write_floorplan(load_map("twin-01"), tmp_path / "twin.json")
    assert "materials" not in json.loads((tmp_path / "twin.json").read_text())


@pytest.mark.parametrize(
    ("materials", "message"),
    [
        ({"glas": [1]}, "did you mean 'glass'"),
        ({"glass": [4]}, "walls are 0 to 3"),
        ({"glass": [-1]}, "walls are 0 to 3"),
        ({"glass": [True]}, "walls are 0 to 3"),
        ({"glass": 1}, "must be a list"),
        ([1], "must be a JSON object"),
    ],
)
def test_invalid_materials_are_rejected(materials, message):
    with pytest.raises(MapError, match=message):
        validate(floorplan_from_values({**values(), "materials": materials}, "hut"))


@pytest.mark.parametrize("floor", [1.5, "up", True, 1000])
def test_invalid_storeys_are_rejected(floor):
    access_point = {"name": "a", "position_m": [1, 1], "macs": ["02:00:5e:00:00:01"], "floor": floor}
    with pytest.raises(MapError, match="floor must be a whole number"):
        floorplan_from_values({**values(), "access_points": [access_point]}, "hut")


def test_materials_are_given_for_all_walls_or_none():
    plan = load_map("twin-01")
    with pytest.raises(MapError, match="1 materials"):
        validate(dataclasses.replace(plan, wall_materials=("glass",)))
    assert validate(dataclasses.replace(plan, wall_materials=("glass",) * len(plan.walls_m))) is not None
    assert np.isfinite(plan.wall_loss_db).all()
