import numpy as np
import pytest

from twc_env.datasets.map_export import export_map
from twc_env.datasets.picture import read_picture
from twc_env.datasets.raster import read_grey
from twc_env.datasets.ros_map import read_ros_cells
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
