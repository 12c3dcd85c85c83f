import dataclasses

import numpy as np
import pytest

from twc_env.datasets.buildings.furnish import SIGN_SPACING_M
from twc_env.datasets.buildings.map_export import export_map, lost_in_export
from twc_env.datasets.buildings.picture import read_picture
from twc_env.datasets.buildings.raster import read_grey
from twc_env.datasets.buildings.ros_map import read_ros_cells
from twc_env.errors import MapError
from twc_env.maps import load_map


def test_json_keeps_the_plan(tmp_path):
    plan = load_map("gen:ward:200:1")
    assert load_map(export_map(plan, tmp_path / "a.json")).digest == plan.digest


@pytest.mark.parametrize("resolution_m", [0.05, 0.1])
def test_a_ros_map_keeps_the_cells(tmp_path, resolution_m):
    plan = load_map("twin-01")
    cells = plan.cells(resolution_m)
    ros_map = read_ros_cells(export_map(plan, tmp_path / "a.yaml", resolution_m))
    assert np.array_equal(ros_map.free, cells.free)
    assert np.array_equal(ros_map.occupied, cells.wall)
    assert ros_map.origin[:2] == pytest.approx(cells.origin_m)


def test_a_ros_map_comes_back_as_a_plan_of_the_same_floor(tmp_path):
    plan = load_map("twin-02")
    again = load_map(export_map(plan, tmp_path / "a.yaml"))
    assert again.floor_area_m2 == pytest.approx(plan.floor_area_m2, rel=0.06)
    assert again.bounds_m == pytest.approx(plan.bounds_m, abs=0.1)


@pytest.mark.parametrize("suffix", ["yaml", "png"])
@pytest.mark.parametrize("turn_deg", [10.0, 30.0, 45.0, 81.0])
def test_a_turned_building_comes_back_with_as_many_signs_as_a_straight_one(tmp_path, suffix, turn_deg):
    if suffix == "png":
        pytest.importorskip("PIL", reason="Pillow is an optional dependency")
    plan = load_map("twin-01")
    straight = load_map(export_map(plan, tmp_path / f"straight.{suffix}"))
    turned = load_map(export_map(plan.moved(np.array([30.0, -400.0, np.deg2rad(turn_deg)])), tmp_path / f"a.{suffix}"))
    assert len(turned.signs) == len(straight.signs) == 21
    places = np.array([sign.position_m for sign in turned.signs])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 99 * np.eye(len(places))
    assert gaps.min() >= SIGN_SPACING_M
    assert turned.wall_index.distance_m(places, 1.0).max() < 0.06


def test_signs_on_the_stairs_of_a_slanted_wall_face_as_the_wall_does(tmp_path):
    turned = load_map("twin-01").moved(np.array([0.0, 0.0, np.pi / 4]))
    again = load_map(export_map(turned, tmp_path / "a.yaml"))
    off_deg = [(np.degrees(sign.facing_rad) % 90) - 45 for sign in again.signs]
    assert np.abs(off_deg).max() < 1.0


@pytest.mark.parametrize("yaw_rad", [0.0, 0.1, 0.7, 3.0])
def test_a_ros_map_far_from_the_origin_keeps_its_signs_at_any_yaw(tmp_path, yaw_rad):
    path = export_map(
        load_map("gen:mall:1200:3").moved(np.array([30.0, -400.0, np.deg2rad(60.5)])), tmp_path / "a.yaml", 0.2
    )
    text = path.read_text()
    path.write_text(text.replace(text.splitlines()[2], f"origin: [130.03, -4000.7, {yaw_rad}]"))
    assert len(load_map(path).signs) == 108


@pytest.mark.parametrize(
    ("name", "remark"),
    [
        ("a.json", ""),
        ("a.yaml", "left out: 5 rooms, 14 signs, 14 access points; read again, the map gets other signs"),
        ("a.png", "left out: 5 rooms, 14 signs, 14 access points; read again, the map gets other signs"),
    ],
)
def test_the_export_names_what_a_file_does_not_hold(name, remark):
    assert remark in lost_in_export(load_map("twin-01"), name)
    assert bool(lost_in_export(load_map("twin-01"), name)) == bool(remark)
    bare = dataclasses.replace(load_map("twin-01"), rooms=(), signs=(), access_points=())
    assert lost_in_export(bare, name) == ""


def test_a_picture_shows_free_space_white_and_walls_black(tmp_path):
    pytest.importorskip("PIL", reason="Pillow is an optional dependency")
    plan = load_map("sfw-e3")
    path = export_map(plan, tmp_path / "a.png")
    cells = plan.cells(0.05)
    grey = read_grey(path)[::-1]
    assert np.array_equal(grey == 255, cells.free)
    assert np.array_equal(grey == 0, cells.wall)
    assert read_picture(path).floor_area_m2 == pytest.approx(cells.free.sum() * 0.05**2, rel=0.05)


@pytest.mark.parametrize(
    ("name", "resolution_m", "expected"),
    [
        ("a.dxf", 0.05, "cannot export to 'a.dxf'; use a name that ends in .json, .yaml, .png"),
        ("a.json", 0.0, "must be 0.01 to 1 m per pixel; got 0"),
        ("taken/a.json", 0.05, "cannot write .*; choose another place"),
        ("taken/a.png", 0.05, "cannot write .*; choose another place"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, name, resolution_m, expected):
    (tmp_path / "taken").touch()
    with pytest.raises(MapError, match=expected) as caught:
        export_map(load_map("sfw-e1"), tmp_path / name, resolution_m)
    assert "\n" not in str(caught.value)
