import dataclasses
import json
import re

import numpy as np
import pytest

from twc_env.datasets.lasting_maps import FORMAT, REMEDY, read_lasting_map, write_lasting_map
from twc_env.datasets.logs.arrays_file import write_arrays
from twc_env.errors import DataError
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import Fingerprint, GridMap, SignObservation


def small_map() -> LastingMap:
    """Three keyframes, two of which read signs and one of which heard transmitters."""
    signs = (
        (SignObservation("ROOM 1", np.array([1.0, -0.5]), 0.25), SignObservation("EXIT", np.array([2.0, 0.5]), np.nan)),
        (),
        (SignObservation("ROOM 1", np.array([0.5, 0.5]), -1.5),),
    )
    nothing = Fingerprint(np.zeros(0, np.int64), np.zeros(0))
    return LastingMap(
        poses=np.array([[0.0, 0.0, 0.0], [1.0, 0.25, 0.5], [2.0, -0.125, 3.0]]),
        scans_m=np.array([[1.0, 2.5, -0.75, 10.0], [0.5, 0.5, 0.5, -0.001], [3.0, 4.0, 5.0, 6.0]]),
        sessions_of=np.array([0, 0, 1]),
        signs=signs,
        fingerprints=(nothing, Fingerprint(np.array([5, 2**47]), np.array([-40.5, -71.0])), nothing),
        edge_ends=np.array([[0, 1], [0, 2]]),
        edge_measured=np.array([[1.0, 0.25, 0.5], [2.0, -0.125, 3.0]]),
        edge_information=np.stack([np.eye(3), 4 * np.eye(3)]),
        is_closure=np.array([False, True]),
        grid=GridMap(np.array([[0, -12, 20], [3, -4, 0]], np.int16), np.array([-1.5, 2.0]), 0.1),
        range_max_m=10.0,
        sessions=2,
    )


def test_a_map_is_read_as_it_was_written(tmp_path):
    told = small_map()
    size = write_lasting_map(tmp_path / "map.npz", told)
    read = read_lasting_map(tmp_path / "map.npz")
    assert size == (tmp_path / "map.npz").stat().st_size
    for field in dataclasses.fields(LastingMap):
        before, after = getattr(told, field.name), getattr(read, field.name)
        if isinstance(before, np.ndarray):
            assert np.array_equal(before, after) if field.name != "scans_m" else np.allclose(before, after)
    assert [[s.text for s in own] for own in read.signs] == [["ROOM 1", "EXIT"], [], ["ROOM 1"]]
    assert np.array_equal(read.signs[0][1].position_m, [2.0, 0.5]) and np.isnan(read.signs[0][1].facing_rad)
    assert np.array_equal(read.fingerprints[1].macs, [5, 2**47])
    assert np.array_equal(read.fingerprints[1].rssi_dbm, [-40.5, -71.0])
    assert np.array_equal(read.grid.log_odds, told.grid.log_odds) and read.sessions == 2


def test_the_file_holds_arrays_and_json_only(tmp_path):
    write_lasting_map(tmp_path / "map.npz", small_map())
    with np.load(tmp_path / "map.npz", allow_pickle=False) as file:
        assert all(file[name].dtype.kind in "iufbU" for name in file.files)
        assert json.loads(str(file["header"]))["keyframes"] == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": np.array("twc_env/lasting-map-0")}, f"expected '{FORMAT}'"),
        ({"poses": np.zeros((2, 3))}, "scans_m of shape"),
        ({"poses": np.full((3, 3), np.nan)}, "poses that are not finite"),
        ({"edge_ends": np.array([[0, 1], [0, 3]], np.int32)}, "edge_ends up to 3"),
        ({"sign_counts": np.array([2, 1, 1], np.int32)}, "sign_counts counts 4"),
        ({"sign_texts": np.array([0, 2, 1], np.int32)}, "sign_texts up to 2"),
        ({"header": np.array("no JSON")}, "header that is no JSON"),
        ({"header": np.array("{}")}, "a header without range_max_m"),
        ({"grid": np.zeros(3, np.int16)}, "a grid of shape"),
        ({"macs": np.array([1.5, 2.5])}, "macs of type float64"),
        ({"grid_origin_m": np.array([0.0, -1e300])}, "grid_origin_m up to 1e+300 m, and 1e+06 m is too far"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_in_one_line(tmp_path, change, message):
    write_lasting_map(tmp_path / "map.npz", small_map())
    with np.load(tmp_path / "map.npz") as file:
        arrays = {name: file[name] for name in file.files}
    write_arrays(tmp_path / "map.npz", **(arrays | change))
    with pytest.raises(DataError, match=re.escape(message)) as refused:
        read_lasting_map(tmp_path / "map.npz")
    assert "\n" not in str(refused.value) and "save the map again" in str(refused.value)


@pytest.mark.parametrize(
    ("version", "told"),
    [("2", "a newer version wrote it; update twc_env"), ("0", REMEDY), ("x", REMEDY), (5000 * "9", REMEDY)],
)
def test_a_map_of_a_newer_format_needs_a_newer_version_of_the_package(tmp_path, version, told):
    write_arrays(tmp_path / "map.npz", format=np.array(f"twc_env/lasting-map-{version}"))
    with pytest.raises(DataError, match=f"expected '{FORMAT}': {told}$"):
        read_lasting_map(tmp_path / "map.npz")


def test_every_damaged_byte_and_every_cut_is_noticed(tmp_path):
    path = tmp_path / "map.npz"
    write_lasting_map(path, small_map())
    whole, random = path.read_bytes(), np.random.default_rng(0)
    for place in random.integers(0, len(whole), 60).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x21]) + whole[place + 1 :])
        with pytest.raises(DataError):
            read_lasting_map(path)
        path.write_bytes(whole[:place])
        with pytest.raises(DataError):
            read_lasting_map(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"nowhere\.npz"):
        read_lasting_map(tmp_path / "nowhere.npz")
