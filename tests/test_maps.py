import gzip
import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from twc_env.datasets.buildings.ros_map import write_ros_map
from twc_env.errors import ConfigError, MapError
from twc_env.maps import load_map, map_names
from twc_env.records.messages import GridMap
from twc_env.world.building import floorplan_file
from twc_env.world.building.floorplan_file import write_floorplan

HOUSE = {
    "id": "house",
    "room_num": 1,
    "verts": [[0.1, 0.1], [6.1, 0.1], [6.1, 5.1], [0.1, 5.1]],
    "bbox": {"min": [0.1, 0.1], "max": [6.1, 5.1]},
    "room_category": {"Kitchen": [[0.1, 0.1, 6.1, 5.1]]},
}


@pytest.fixture
def house(tmp_path):
    path = tmp_path / "house.json"
    path.write_text(json.dumps(HOUSE))
    return path


@pytest.mark.parametrize("seed", [-1, 1.5])
def test_seeds_other_than_non_negative_integers_are_rejected(house, seed):
    with pytest.raises(ConfigError, match=f"seed must be a whole number of at least 0; got {seed}"):
        load_map(house, seed)


@pytest.mark.parametrize("name", map_names())
def test_each_bundled_map_is_valid_and_named_like_its_file(name):
    plan = load_map(name)
    assert plan.name == name
    assert plan.floor_area_m2 > 15
    assert len(plan.rooms) > 1
    assert all(len(access_point.macs) >= 2 for access_point in plan.access_points)


@pytest.mark.parametrize(
    ("name", "walls_length", "access_points", "repeated"),
    [("twin-01", 30, 14, {"FIRE CABINET": 4, "EXIT": 2}), ("twin-02", 38, 16, {"FIRE HYDRANT": 8, "EXIT": 10})],
)
def test_the_twin_maps_have_repeated_signs_beside_unique_labels(name, walls_length, access_points, repeated):
    plan = load_map(name)
    texts = [sign.text for sign in plan.signs]
    counts = {text: texts.count(text) for text in texts}
    assert {text: count for text, count in counts.items() if count > 1} == repeated
    assert sum(count == 1 for count in counts.values()) >= 2 * (len(plan.rooms) - 1)
    assert len(plan.access_points) == access_points
    corridor = next(room for room in plan.rooms if room.name == "CORRIDOR")
    assert np.ptp(corridor.polygon_m[:, 0]) == walls_length


def test_rooms_of_twin_01_are_congruent():
    plan = load_map("twin-01")
    cells = plan.cells(0.1)
    first = int(round((1.0 - cells.origin_m[0]) / 0.1))
    bottom = int(round((2.4 - cells.origin_m[1]) / 0.1)) + 1
    rooms = [cells.free[bottom : bottom + 58, first + 70 * i : first + 70 * i + 68] for i in range(4)]
    assert rooms[0].sum() > 3000
    assert all(np.array_equal(rooms[0], room) for room in rooms[1:])


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("TWIN-01", "twin-01"),
        ("Train/0001", "train/0001"),
        ("test/1", "test/0001"),
        ("GEN:office:800:7", "gen:office:800:7"),
    ],
)
def test_the_error_of_a_name_in_another_case_suggests_the_correct_one(written, meant):
    with pytest.raises(MapError, match=f"did you mean '{meant}'"):
        load_map(written)


def test_the_error_of_an_unknown_name_suggests_the_nearest_or_lists_all():
    for name, said in (
        ("twin-1", "no map named 'twin-1' and no such file; did you mean 'twin-01'?"),
        ("plan.pdf", "there is no map file 'plan.pdf'; `twc-env maps list` has the bundled and generated ones"),
    ):
        with pytest.raises(MapError) as caught:
            load_map(name)
        assert str(caught.value) == said
    with pytest.raises(MapError, match=r"no map named 'zoo' .*; bundled maps: .*twin-02; generated ones: gen:office"):
        load_map("zoo")


def test_the_error_of_a_folder_lists_the_maps_in_it(tmp_path):
    with pytest.raises(MapError, match="is a folder: name a map file in it; it holds none"):
        load_map(tmp_path)
    for name in ("b.pgm", "a.yaml", "notes.txt"):
        (tmp_path / name).write_text("")
    with pytest.raises(MapError, match=r"is a folder: name a map file in it; it holds a\.yaml, b\.pgm$"):
        load_map(tmp_path)


def test_a_map_is_read_once_and_shared():
    assert load_map("twin-01") is load_map("twin-01")


def test_a_changed_file_is_read_again(tmp_path):
    path = tmp_path / "mine.json"
    write_floorplan(load_map("twin-01"), path)
    first = load_map(path)
    write_floorplan(load_map("twin-02"), path)
    os.utime(path, ns=(1, 1))
    assert load_map(path).digest != first.digest


def test_a_file_with_a_changed_picture_is_read_again(tmp_path):
    widths_m = []
    for columns in (40, 60):
        log_odds = np.where(np.arange(80) < columns, -1, 1) * np.ones((50, 1), np.int16)
        path = write_ros_map(GridMap(log_odds, np.zeros(2), 0.1), tmp_path, "plan")
        os.utime(path, ns=(1, 1))
        os.utime(path.with_suffix(".pgm"), ns=(1, columns))
        widths_m.append(np.ptp(load_map(path).walls_m[..., 0]))
    assert widths_m == pytest.approx([4.0, 6.0])


def test_other_files_in_the_folder_do_not_invalidate_a_picture_map(tmp_path):
    walls = np.pad(np.full((50, 40), 255, np.uint8), 1)
    Image.fromarray(walls).save(tmp_path / "plan.png")
    first = load_map(tmp_path / "plan.png")
    (tmp_path / "film-0001.png").touch()
    assert load_map(tmp_path / "plan.png") is first


def test_a_dangling_picture_link_does_not_prevent_reading_a_map(tmp_path):
    path = write_ros_map(GridMap(np.full((50, 40), -1, np.int16), np.zeros(2), 0.1), tmp_path, "plan")
    (tmp_path / "other.pgm").symlink_to(tmp_path / "gone.pgm")
    assert np.ptp(load_map(path).walls_m[..., 0]) == pytest.approx(4.0)


def test_house_expo_files_are_recognised_by_their_keys(house):
    assert load_map(house).rooms[0].name == "Kitchen"


def test_generated_signs_and_access_points_follow_the_seed(house):
    assert load_map(house, seed=1).digest == load_map(str(house), seed=1).digest
    assert load_map(house, seed=1).digest != load_map(house, seed=2).digest


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.json", "{", "not valid JSON"),
        ("a.json", '{"name": "a", "walls": [], "name": "b"}', "the key 'name' stands twice"),
        ("a.json", "[]", "must be a JSON object"),
        ("a.json", "[" * 100_000, "nests its lists too deeply|not valid JSON"),
        ("a.json#1", "{}", "unknown map format '.json#1'"),
        ("a.dxf", "", "unknown map format '.dxf'; use .json, .yaml, .png, .pgm or .geojson"),
        ("a.jpg", "", "unknown map format '.jpg'; save the picture as .png"),
        ("plain", "", "unknown map format ''"),
    ],
)
def test_files_that_are_not_maps_are_rejected(tmp_path, name, content, expected):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(MapError, match=expected):
        load_map(path)


def test_only_geojson_has_levels(house):
    with pytest.raises(MapError, match=r"only \.geojson maps have levels; leave #2 out"):
        load_map(f"{house}#2")


@pytest.mark.parametrize("name", ["house.json.gz", "HOUSE.JSON.GZ"])
def test_gzipped_files_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(gzip.compress(json.dumps(HOUSE).encode()))
    assert load_map(tmp_path / name).rooms[0].name == "Kitchen"


def test_a_truncated_gzipped_file_is_rejected(tmp_path):
    path = tmp_path / "house.json.gz"
    path.write_bytes(gzip.compress(json.dumps(HOUSE).encode())[:-9])
    with pytest.raises(MapError, match="cannot read the map"):
        load_map(path)


def test_a_decompression_bomb_is_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr(floorplan_file, "FILE_BYTES_MAX", 1_000_000)
    path = tmp_path / "bomb.json.gz"
    path.write_bytes(gzip.compress(b" " * 2_000_000))
    with pytest.raises(MapError, match="holds more than 1 MB"):
        load_map(path)


def test_bundled_maps_are_documented():
    text = (Path(__file__).parents[1] / "maps" / "README.md").read_text()
    assert all(f"`{name}`" in text for name in map_names())
