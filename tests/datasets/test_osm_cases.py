"""Small buildings in the taggings that editors write, each with its right area and number of rooms."""

import json
import shutil
from pathlib import Path

import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map

CASES = Path(__file__).parent / "cases"
LEVELS = ["plain", "semicolon", "range", "range-neg", "decimal", "float", "int", "list", "comma", "spaces"]
WIDTHS = {"width0": 1.5, "width1": 1.5, "width2": 1.5, "width4": 1.524}


def size(case: str, level: str = "") -> tuple[int, int]:
    """Area [m2] and number of rooms."""
    plan = load_map(f"{CASES / case}.geojson{level}")
    return round(plan.floor_area_m2), len(plan.rooms)


@pytest.mark.parametrize("name", LEVELS)
def test_levels_may_be_lists_ranges_and_decimals(name):
    assert size(f"02-osm-level-range/{name}") == (154, 3)


@pytest.mark.parametrize("name", ["range", "range-neg", "list", "comma", "semicolon"])
def test_a_corridor_of_two_levels_is_on_both(name):
    assert size(f"02-osm-level-range/{name}", "#1") == (40, 1)


def test_a_door_of_one_level_is_not_cut_into_another():
    assert size("03-osm-door-level/two-floors", "#0") == size("03-osm-door-level/level0-alone") == (94, 2)


@pytest.mark.parametrize("name", ["id-preset", "entrance"])
def test_doors_are_known_in_the_tagging_of_editors(name):
    assert size(f"04-osm-indoor-door/{name}") == (154, 3)


@pytest.mark.parametrize("name", ["room-with-door-tag", "room-door-no", "door-line", "z"])
def test_a_room_may_say_whether_it_has_a_door_and_a_door_may_be_a_line(name):
    assert size(f"05-osm-door-shape/{name}") == (154, 3)


@pytest.mark.parametrize("name", WIDTHS)
def test_the_width_of_a_door_has_a_unit_or_a_comma(name):
    from twc_env.datasets.buildings.geojson_features import is_door, width_m_of

    features = json.loads((CASES / "05-osm-door-shape" / f"{name}.geojson").read_text())["features"]
    widths = [width_m_of(feature, name, set()) for feature in features if is_door(feature)]
    assert max(widths) == pytest.approx(WIDTHS[name])


def test_imdf_is_read_with_openings_in_the_file_or_beside_it():
    assert size("06-imdf-unit/both") == size("06-imdf-unit/unit") == (154, 3)


def test_a_width_that_is_not_taken_is_said_once_with_the_name_of_the_file(caplog):
    load_map(CASES / "05-osm-door-shape" / "width6.geojson")
    (said,) = (record.getMessage() for record in caplog.records if "width" in record.getMessage())
    assert said.startswith("width6.geojson: doors of width '0.7' are taken as 0.9 m wide")


def test_openings_of_imdf_alone_are_told_to_need_units(tmp_path):
    shutil.copy(CASES / "06-imdf-unit" / "opening.geojson", tmp_path)
    with pytest.raises(MapError, match=r"holds opening of IMDF and no unit, which are its rooms: name unit\.geojson"):
        load_map(tmp_path / "opening.geojson")


def test_imdf_without_openings_says_that_rooms_have_no_doors(tmp_path, caplog):
    shutil.copy(CASES / "06-imdf-unit" / "unit.geojson", tmp_path)
    assert len(load_map(tmp_path / "unit.geojson").rooms) == 1
    assert "no opening.geojson is beside it: rooms have no doors" in caplog.text
    assert "m2 of floor left out: no door leads there" in caplog.text


def test_an_area_beside_a_corridor_is_open_to_it_and_a_room_is_not(caplog):
    assert size("07-osm-area-walls/lounge-area")[0] == pytest.approx(274, abs=1)
    assert size("07-osm-area-walls/lounge-room")[0] == 154
    assert "m2 of floor left out: no door leads there" in caplog.text


def test_a_wall_drawn_as_a_line_is_a_wall():
    assert len(load_map(CASES / "07-osm-area-walls" / "wall-line.geojson").walls_m) == 5


def test_a_door_in_the_middle_of_a_wall_opens_it():
    area_m2, rooms = size("osm-1")
    assert (area_m2, rooms) == (144, 4)


def test_the_only_level_is_the_one_meant(tmp_path):
    values = (CASES / "02-osm-level-range" / "plain.geojson").read_text().replace('"level": "0"', '"level": "1"')
    (tmp_path / "upper.geojson").write_text(values)
    plan = load_map(tmp_path / "upper.geojson")
    assert (plan.name, round(plan.floor_area_m2)) == ("upper-1", 154)
    with pytest.raises(MapError, match="has no level '0'; levels are 1: write FILE#LEVEL"):
        load_map(f"{tmp_path / 'upper.geojson'}#0")
