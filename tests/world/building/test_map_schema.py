import copy
import json
from pathlib import Path

import jsonschema
import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map, map_names, schema
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.floorplan_file import floorplan_from_values, write_floorplan
from twc_env.world.building.materials import MATERIALS

ROOT = Path(__file__).parents[3]
VALIDATOR = jsonschema.Draft202012Validator(schema())
SOUND = json.loads((ROOT / "maps" / "sfw-e2.json").read_text())


def with_value(path: str, value: object) -> dict:
    """The valid map with the value at a path such as "signs.0.text" replaced, or removed if it is `...`."""
    values = copy.deepcopy(SOUND)
    *way, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    holder = values
    for part in way:
        holder = holder[part]
    if value is ...:
        del holder[last]
    else:
        holder[last] = value
    return values


def test_the_schema_is_a_valid_json_schema():
    jsonschema.Draft202012Validator.check_schema(schema())


@pytest.mark.parametrize("name", map_names())
def test_every_bundled_map_follows_the_schema(name, tmp_path):
    write_floorplan(load_map(name), tmp_path / "a.json")
    assert not list(VALIDATOR.iter_errors(json.loads((tmp_path / "a.json").read_text())))


@pytest.mark.parametrize("path", sorted((ROOT / "maps").glob("*.json")), ids=lambda path: path.stem)
def test_every_map_file_follows_the_schema(path):
    assert not list(VALIDATOR.iter_errors(json.loads(path.read_text())))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("format", "twc_env/floorplan-0"), ("format", ...), ("name", 5), ("walls", ...), ("walls", "none"),
        ("walls.0", [1, 2, 3, 4]), ("walls.0.4", -1), ("walls.0.4", 1e9), ("walls.0.0", "1"), ("walls.0.0", 1e300),
        ("interior_m", ...), ("interior_m", []), ("interior_m.0", [1]), ("starts", [[1, 2]]), ("wals", []),
        ("rooms.0.polygon_m", [[0, 0], [1, 1]]), ("rooms.0.name", None), ("rooms.0.colour", "red"),
        ("signs.0.text", " "), ("signs.0.facing_rad", [0]), ("signs.0.facing_rad", 90),
        ("signs.0.position_m", [1, 2, 3]), ("access_points.0.macs", []), ("access_points.0.macs.0", "02:00"),
        ("access_points.0.macs", [5]), ("access_points.0.name", ...), ("pose_building_home", [1, 2]),
    ],
)  # fmt: skip
def test_schema_and_reader_reject_the_same_mistakes(path, value):
    values = with_value(path, value)
    assert not VALIDATOR.is_valid(values)
    with pytest.raises(MapError):
        validate(floorplan_from_values(values, "a.json"))


@pytest.mark.parametrize("material", MATERIALS)
def test_schema_and_reader_know_every_material(material):
    values = with_value("materials", {material: [0]})
    assert VALIDATOR.is_valid(values)
    assert floorplan_from_values(values, "a.json").wall_materials[0] == material


def test_a_wall_of_two_materials_is_refused():
    values = with_value("materials", {"glass": [0, 1], "brick": [2, 1]})
    with pytest.raises(MapError, match=r"a\.json: materials names wall 1 as glass and as brick; keep one"):
        floorplan_from_values(values, "a.json")
    values["materials"] = {"glass": [1, 1]}
    assert floorplan_from_values(values, "a.json").wall_materials[1] == "glass"
