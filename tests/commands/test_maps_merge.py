import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.slam.saved_maps.cuts import saved_cut
from twc_env.__main__ import main
from twc_env.datasets.buildings.ros_map import read_ros_cells
from twc_env.offline.map_merge import read_saved_maps


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two maps of one building, as files."""
    return saved_cut(tmp_path_factory.mktemp("maps"))


def test_two_maps_are_merged_into_one(files, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is an optional dependency")
    assert main(["maps", "merge", *files, "--out", str(tmp_path / "m")]) == 0
    out = capsys.readouterr().out
    assert "yaw [deg]" in out and "certainty" in out
    found = json.loads((tmp_path / "m" / "transforms.json").read_text())
    assert [part["name"] for part in found["groups"][0]["maps"]] == ["monday", "tuesday"]
    assert found["pairs"][0]["merged"] and found["pairs"][0]["reason"] == ""
    grid = read_ros_cells(tmp_path / "m" / "map.yaml")
    assert grid.free.sum() * grid.resolution_m**2 > 250
    assert (tmp_path / "m" / "map.png").stat().st_size > 10_000


def test_maps_that_do_not_fit_stay_apart_with_a_reason(files, tmp_path, capsys):
    assert main(["maps", "merge", files[0], "sfw-e3", "--out", str(tmp_path)]) == 1
    assert "monday and sfw-e3 not merged:" in capsys.readouterr().out
    assert not (tmp_path / "map.yaml").exists()
    assert json.loads((tmp_path / "transforms.json").read_text())["groups"][1]["map"] is None


def test_maps_of_one_name_are_told_apart_by_their_folders(files, tmp_path):
    for day, file in zip(("monday", "tuesday"), files, strict=True):
        shutil.copytree(Path(file).parent, tmp_path / day)
        (tmp_path / day / Path(file).name).rename(tmp_path / day / "map.yaml")
    found = read_saved_maps([str(tmp_path / day / "map.yaml") for day in ("monday", "tuesday")])
    assert [one.name for one in found] == ["monday/map", "tuesday/map"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.yaml"], "merging takes two maps or more"),
        (["nothing.yaml", "sfw-e3"], "there is no map file 'nothing.yaml'"),
        (["sfw-e3", "sfw-e4", "--resolution", "0"], "--resolution must be 0.005 to 10 m per pixel; got 0"),
    ],
)
def test_bad_input_is_one_line(arguments, message, tmp_path, capsys):
    assert main(["maps", "merge", *arguments, "--out", str(tmp_path / "m")]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error


def test_a_picture_without_a_free_pixel_is_named(tmp_path, capsys):
    (tmp_path / "grey.pgm").write_bytes(b"P5\n40 40\n255\n" + np.full(1600, 205, np.uint8).tobytes())
    assert main(["maps", "merge", str(tmp_path / "grey.pgm"), "sfw-e3", "--out", str(tmp_path / "m")]) == 2
    assert "grey.pgm shows no free floor" in capsys.readouterr().err
