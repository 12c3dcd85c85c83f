"""Pictures and map_server maps that are not closed, tell no scale, or mean other greys than they say."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map

pytest.importorskip("PIL")
CASES = Path(__file__).parent / "cases"


def test_a_gap_in_the_outer_wall_does_not_make_the_outside_floor():
    with pytest.raises(MapError, match="pixels of the picture's border, so that the outside is floor: close the gaps"):
        load_map(CASES / "plan-1.png")


@pytest.fixture
def plan_2(tmp_path):
    return Path(shutil.copy(CASES / "plan-2.png", tmp_path))


def test_an_assumed_scale_and_writing_are_said(plan_2, caplog):
    load_map(plan_2)
    assert "0.05 m per pixel assumed" in caplog.text
    assert "left out" not in caplog.text
    assert "if they are writing, erase it" in caplog.text


def test_floor_left_out_is_said(tmp_path, caplog):
    load_map(shutil.copy(CASES / "15-map-half-dropped" / "two-rooms.png", tmp_path))
    assert "14 of 28 m2 of floor left out: not connected" in caplog.text


@pytest.mark.parametrize("name", ["map", "png", "map196"])
def test_the_grey_of_map_saver_is_unknown_under_any_threshold(tmp_path, caplog, name):
    folder = shutil.copytree(CASES / "01-nav2-free-thresh", tmp_path / "maps")
    plan = load_map(folder / f"{name}.yaml")
    assert plan.floor_area_m2 == pytest.approx(10.0, abs=0.2)
    assert ("write free_thresh: 0.196" in caplog.text) == (name != "map196")


def test_a_yaw_that_is_no_number_is_said_to_be_zero(tmp_path, caplog):
    folder = shutil.copytree(CASES / "01-nav2-free-thresh", tmp_path / "maps")
    assert load_map(folder / "nan-yaw.yaml").bounds_m == pytest.approx(load_map(folder / "map196.yaml").bounds_m)
    assert "yaw of origin is no number; 0 is assumed" in caplog.text


@pytest.mark.parametrize("suffix", ["jpg", "bmp"])
def test_pictures_that_ros_reads_are_read(tmp_path, suffix):
    from PIL import Image

    pixels = np.zeros((60, 80), np.uint8)
    pixels[8:52, 8:72] = 254
    Image.fromarray(pixels).save(tmp_path / f"map.{suffix}")
    text = "resolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "map.yaml").write_text(f"image: map.{suffix}\n{text}")
    assert load_map(tmp_path / "map.yaml").floor_area_m2 == pytest.approx(28.2, rel=0.02)


def test_a_picture_of_more_floor_than_is_possible_is_refused_at_once(tmp_path, monkeypatch):
    from PIL import Image

    from twc_env.datasets.buildings import raster

    white = Image.fromarray(np.pad(np.full((100, 90), 255, np.uint8), 40))
    white.save(tmp_path / "known.png")
    white.save(tmp_path / "white.png")
    load_map(tmp_path / "known.png")
    monkeypatch.setattr(raster, "FLOOR_CELLS_MAX", 8999)
    monkeypatch.setattr(raster, "parts", lambda *_: pytest.fail("looked at"))
    with pytest.raises(
        MapError, match=r"white\.png: 9000 pixels of floor, 8999 are possible; make the picture coarser"
    ):
        load_map(tmp_path / "white.png")


def test_a_picture_of_noise_is_refused_at_once(tmp_path, monkeypatch):
    from PIL import Image

    from twc_env.datasets.buildings import picture, raster

    monkeypatch.setattr(raster, "EDGES_MAX", 400_000)
    monkeypatch.setattr(picture, "name_marks", lambda *_: pytest.fail("looked at"))
    noise = np.random.default_rng(0).random((900, 900)) < 0.5
    Image.fromarray(np.where(noise, 255, 0).astype(np.uint8)).save(tmp_path / "noise.png")
    with pytest.raises(MapError, match=r"noise\.png: 8\d+ edges of pixels between .*, 400000 are possible"):
        load_map(tmp_path / "noise.png")
