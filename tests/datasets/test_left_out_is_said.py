"""Whatever a reader leaves out or assumes is said in a warning or a note."""

import json

import numpy as np
import pytest

from tests.datasets.buildings.test_geojson import box, collection, node, polygon, room
from twc_env.datasets.buildings.grid_file import read_grid
from twc_env.datasets.buildings.raster import plan_from_free
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.carmen_writer import write_carmen_log
from twc_env.datasets.logs.column_units import Span
from twc_env.datasets.logs.readings_table import read_signs, read_wifi
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.logs.tum import read_tum
from twc_env.maps import load_map

LOG = Span(1000.0, 1010.0)


def loaded(tmp_path, *features):
    (tmp_path / "a.geojson").write_text(json.dumps(collection(*features)))
    return load_map(tmp_path / "a.geojson")


def two_rooms(**first):
    return (
        polygon(box(0, 0, 8, 4), tags={"indoor": "room", "level": "1", **first}),
        polygon(box(0, 4.2, 8, 7.2), tags={"indoor": "room", "level": "1"}),
        node(4, 4.1, door="yes"),
    )


def test_an_outline_drawn_as_a_closed_line_is_a_room(tmp_path, caplog):
    first, *others = two_rooms()
    first["geometry"] = {"type": "LineString", "coordinates": first["geometry"]["coordinates"][0]}
    plan = loaded(tmp_path, first, *others)
    assert (len(plan.rooms), round(plan.floor_area_m2)) == (2, 56)
    assert caplog.text == ""


def test_an_outline_that_is_not_closed_is_named(tmp_path, caplog):
    odd = polygon(box(0, 8, 8, 12), tags={"indoor": "room", "level": "1"})
    odd["geometry"] = {"type": "LineString", "coordinates": odd["geometry"]["coordinates"][0][:-1]}
    assert len(loaded(tmp_path, *two_rooms(), odd).rooms) == 2
    assert "1 rooms left out: their outlines are not closed; draw them as polygons" in caplog.text


def test_a_room_without_a_level_is_on_the_usual_one_and_named(tmp_path, caplog):
    assert len(loaded(tmp_path, *two_rooms(level="")).rooms) == 2
    assert "1 rooms tell no level and are taken to be on 1; tag them" in caplog.text


def test_a_door_that_opens_nothing_is_named(tmp_path, caplog):
    outside = node(0, 2, door="yes")
    afar = node(30, 30, door="yes")
    loaded(tmp_path, *two_rooms(), outside, afar)
    assert "2 of 3 doors stay closed: they lead outside" in caplog.text


@pytest.mark.parametrize(("width", "taken"), [("0.5", "0.9"), ("90", "3"), ("1.2", "")])
def test_a_width_that_no_door_has_is_named(tmp_path, caplog, width, taken):
    first, second, _ = two_rooms()
    loaded(tmp_path, first, second, node(4, 4.1, door="yes", width=width))
    assert (f"doors of width {width!r} are taken as {taken} m wide" in caplog.text) == bool(taken)


def test_floor_that_places_close_in_is_named(tmp_path, caplog):
    (tmp_path / "floor_info.json").write_text('{"map_info": {"width": 20.0, "height": 10.0}}')
    features = collection(polygon(box(0, 0, 20, 10), name="F1"), polygon(box(8, -1, 9, 11), name="a wall of shops"))
    (tmp_path / "geojson_map.json").write_text(json.dumps(features))
    load_map(tmp_path / "geojson_map.json")
    assert "m2 between its places left out: they are closed in by places" in caplog.text


def test_floor_behind_a_narrow_gap_is_named(caplog):
    free = np.zeros((60, 121), bool)
    free[5:55, 5:60] = free[5:55, 62:115] = True
    free[30:33, 60:62] = True
    plan_from_free(free, 0.05, "two rooms")
    assert "two rooms: 7 of 14 m2 of floor left out: no passage wider than 0.2 m leads there" in caplog.text


def test_floor_that_a_flat_touches_in_a_point_is_named(tmp_path, caplog):
    verts = [[0, 0], [8, 0], [8, 8], [4, 4], [2, 8], [0, 8], [4, 4]]
    (tmp_path / "a.json").write_text(json.dumps({"id": "a", "verts": verts, "room_category": {}}))
    load_map(tmp_path / "a.json")
    assert "m2 of floor left out: the contour touches itself, and nothing leads there" in caplog.text


def test_the_scale_of_a_picture_that_is_merged_is_said(tmp_path, caplog):
    image = pytest.importorskip("PIL.Image")
    pixels = np.zeros((80, 80), np.uint8)
    pixels[8:72, 8:72] = 254
    image.fromarray(pixels).save(tmp_path / "a.png")
    assert read_grid(tmp_path / "a.png").resolution_m == 0.05
    assert "0.05 m per pixel assumed, 4.0 x 4.0 m in all; if it is another, use --resolution" in caplog.text
    caplog.clear()
    read_grid(tmp_path / "a.png", 0.05)
    assert caplog.text == ""


def log_of(path, beams=91, count=6):
    """A CARMEN log of a robot that drives through a round room."""
    poses = np.stack([0.3 * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    ranges = np.full((count, beams), 4.0)
    write_carmen_log(path, ScanLog(1000.0 + np.arange(count), poses, ranges, np.linspace(-1.5, 1.5, beams)), 20.0)


def test_lines_of_other_lasers_are_named(tmp_path, caplog):
    log_of(tmp_path / "a.log")
    lines = (tmp_path / "a.log").read_text()
    behind = lines.replace("ROBOTLASER1", "ROBOTLASER2")
    (tmp_path / "a.log").write_text(lines + behind)
    assert len(read_any_log(tmp_path / "a.log").times_s) == 6
    assert "lines of other lasers left out, since ROBOTLASER1 come first: 6 ROBOTLASER2" in caplog.text


def test_scans_before_the_odometry_are_named(tmp_path, caplog):
    scan = "RAWLASER1 0 -1.5708 3.1416 0.0349 20.0 0.01 0 90 " + "4.0 " * 90 + "0"
    lines = [f"{scan} {990 + k} host {990 + k}" for k in range(20)]
    lines += [f"ODOM {0.1 * k} 0 0 0 0 0 {1000 + k} host {1000 + k}" for k in range(20)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    assert len(read_any_log(tmp_path / "a.log").times_s) == 10
    assert "10 of 20 RAWLASER1 lines left out: they are before or after all ODOM lines" in caplog.text


@pytest.mark.parametrize(("beams", "is_said"), [(271, True), (181, False)])
def test_the_half_circle_of_a_log_in_json_is_said_and_its_name_does_not_matter(tmp_path, caplog, beams, is_said):
    scan = {"range": [4.0] * beams, "x": 0.0, "y": 0.0, "theta": 0.0}
    (tmp_path / "a.txt").write_text(json.dumps({"map": {"0": scan, "1": scan}}))
    assert read_any_log(tmp_path / "a.txt").ranges_m.shape == (2, beams)
    assert (f"the {beams} beams of a scan are taken for a half circle" in caplog.text) == is_said


@pytest.mark.parametrize(
    ("row", "is_said"), [("2 0 0 1.5 0 0 0 1", True), ("2 0 0 0.1 0.4 0 0 1", True), ("2 0 0 0.1 0 0 1 0", False)]
)
def test_a_trajectory_that_leaves_its_plane_is_named(tmp_path, caplog, row, is_said):
    (tmp_path / "a.tum").write_text(f"1 0 0 0 0 0 0 1\n{row}\n")
    read_tum(tmp_path / "a.tum")
    assert ("are dropped; positions are x and y of the file" in caplog.text) == is_said


def test_units_zones_and_rows_of_a_table_are_noted(tmp_path):
    path = tmp_path / "wifi.csv"
    path.write_text("".join(f"{t * 1000:.0f},aa:bb:cc:dd:ee:0{k},-50\n" for k, t in enumerate((500, 1001, 1002))))
    _, notes = read_wifi(path, Span(1000.0, 1010.0, units={"time": "ms"}))
    assert notes[1:] == [
        f"{path}: without a header, the columns are taken for time, address, strength",
        f"{path}: times in ms",
        f"{path}: 1 readings before or after the log left out",
    ]
    path.write_text("time,text,bearing,range\n1970-01-01T00:16:41,A,170,2\n1970-01-01T00:16:42,,170,2\n")
    _, notes = read_signs(path, LOG)
    assert notes[1:] == [
        f"{path}: times without a time zone are taken for UTC",
        f"{path}: 1 readings without a text left out",
    ]
    path.write_text("time,text,bearing,range\n1970-01-01T00:16:41Z,A,170,2\n")
    assert len(read_signs(path, LOG)[1]) == 1


def test_scans_of_a_bag_that_are_not_used_are_noted(tmp_path):
    pytest.importorskip("rosbags")
    from tests.datasets.test_bag_log import recording
    from twc_env.datasets.ros.bag_log import read_bag
    from twc_env.datasets.ros.bag_writer import write_recording
    from twc_env.datasets.ros.robot_topics import Wishes

    write_recording(tmp_path / "a.bag", [recording("robot_0"), recording("robot_1")])
    (found,) = read_bag(tmp_path / "a.bag", Wishes(scan=("/robot_0/scan",)))
    assert "scans of /robot_1/scan are not used; choose them by --scan-topic" in found.notes


def test_a_room_of_another_level_is_no_guess(tmp_path, caplog):
    loaded(tmp_path, room(box(0, 0, 8, 4), "001"), room(box(0, 4.2, 8, 7.2), "101", "1"))
    assert "tell no level" not in caplog.text
