import gzip
import json
import lzma

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.carmen_log import read_carmen_log
from twc_env.datasets.logs.scan_log import read_relations, read_scan_log
from twc_env.datasets.surveys.ble_drive import read_ble_drive
from twc_env.datasets.surveys.ble_flat import read_ble_run, read_flat
from twc_env.datasets.surveys.fingerprints import read_numbers, read_table
from twc_env.datasets.surveys.indoor20 import read_indoor20
from twc_env.datasets.surveys.sfw_authors import read_authors_walk
from twc_env.datasets.surveys.sod_indoor_loc import read_sod
from twc_env.datasets.surveys.uji_library import read_uji_library
from twc_env.datasets.surveys.uw_floor import read_uw_floor
from twc_env.errors import DataError


def test_readings_of_one_time_are_one_scan(tmp_path):
    path = tmp_path / "floor.txt"
    path.write_text("100.5 aa 1.0 2.0 -60\n100.5 bb 1.0 2.0 -70\n100.5 aa 1.0 2.0 -58\n103.5 bb 4.0 2.0 -80\n")
    survey = read_uw_floor(path)
    assert survey.addresses == ("aa", "bb")
    assert survey.position_m.tolist() == [[1.0, 2.0], [4.0, 2.0]]
    assert survey.time_s.tolist() == [0.0, 3.0]
    assert survey.rssi_dbm[0].tolist() == [-58.0, -70.0]
    assert np.isnan(survey.rssi_dbm[1, 0])


def test_phone_scans_lie_between_waypoints_and_lose_their_stale_rows(tmp_path):
    (tmp_path / "traces").mkdir()
    lines = [
        "# header", "1000\tTYPE_WAYPOINT\t0.0\t0.0", "11000\tTYPE_WAYPOINT\t10.0\t5.0",
        "6000\tTYPE_WIFI\t\taa\t-50\t2412\t5500", "6000\tTYPE_WIFI\t\tbb\t-60\t5180\t1500",
        "20000\tTYPE_WIFI\t\taa\t-55\t2412\t20000",
    ]  # fmt: skip
    (tmp_path / "traces" / "walk.txt.xz").write_bytes(lzma.compress("\n".join(lines).encode()))
    survey = read_indoor20(tmp_path)
    assert survey.addresses == ("aa",)
    assert survey.position_m.tolist() == [[5.0, 2.5]]
    both = read_indoor20(tmp_path, age_max_s=30.0)
    assert both.addresses == ("aa", "bb")
    assert both.is_high_band.tolist() == [False, True]


def test_relations_belong_to_two_different_scans(tmp_path):
    log, relations = tmp_path / "log.json.gz", tmp_path / "log.relations"
    scans = {time: {"range": [1.0, 2.0], "x": x, "y": 0.0, "theta": 0.5} for time, x in (("12.0", 2), ("10.0", 1))}
    log.write_bytes(gzip.compress(json.dumps({"map": scans}).encode()))
    relations.write_text("10.001 12.0 1 0 0 0 0 0.2\n10.0 10.001 1 0 0 0 0 0\n10.0 11.0 1 0 0 0 0 0\n")
    found = read_scan_log(log)
    assert found.times_s.tolist() == [10.0, 12.0]
    assert found.poses[:, 0].tolist() == [1.0, 2.0]
    pairs = read_relations(relations, found)
    assert (pairs.first.tolist(), pairs.second.tolist()) == ([0], [1])
    assert pairs.pose_first_second.tolist() == [[1.0, 0.0, 0.2]]
    assert pairs.away_s == pytest.approx([0.001])


SCAN = '{"range": [1, 2], "x": 3, "y": 0, "theta": 0}'


@pytest.mark.parametrize(
    ("name", "content", "read"),
    [
        ("floor.txt", "100.5 aa 1.0 2.0", read_uw_floor),
        ("floor.txt", "", read_uw_floor),
        ("floor.txt", "x aa 1 2 -60", read_uw_floor),
        ("floor.txt", "1 aa 0 0 nan", read_uw_floor),
        ("log.json", "{}", read_scan_log),
        ("log.json", '{"map": {}}', read_scan_log),
        ("log.json", f'{{"map": {{"1": {SCAN}, "2": {SCAN.replace("3", "null")}}}}}', read_scan_log),
        ("log.json", f'{{"map": {{"1": {SCAN}, "nan": {SCAN}}}}}', read_scan_log),
        ("carmen.log", "FLASER -2 1 1 0 0 0 0 0 0 12 h 12", read_carmen_log),
        ("carmen.log", "FLASER 1 1.0 0 nan 0 0 0 0 12 h 12", read_carmen_log),
        ("table.csv", 'x,y\n1,"' + 200_000 * "2", read_table),
        ("log.json", '{"map": {"1": 3}}', read_scan_log),
        ("log.json", '{"map": {"1": ', read_scan_log),
        ("carmen.log", "ODOM 0 0 0", read_carmen_log),
        ("carmen.log", "FLASER 2 1.0 2.0 0 0", read_carmen_log),
        ("layout.csv", "x,z\n1,2\n", lambda p: read_flat(p.parent)),
        ("layout.csv", "x,y\n1,2\n3\n", lambda p: read_flat(p.parent)),
        ("none", "", lambda p: read_sod(p.parent, "CETC331")),
        ("none", "", lambda p: read_sod(p.parent, "another")),
        ("none", "", lambda p: read_uji_library(p.parent, "01")),
        ("none", "", lambda p: read_ble_run(p.parent, "calib9")),
        ("none", "", lambda p: read_indoor20(p.parent)),
    ],
)
def test_broken_files_are_data_errors(tmp_path, name, content, read):
    (tmp_path / name).write_text(content)
    with pytest.raises(DataError):
        read(tmp_path / name)


TRACE = "1000\tTYPE_WAYPOINT\t0\t0\n9000\tTYPE_WAYPOINT\t5\t5\n"


@pytest.mark.parametrize(
    ("name", "content", "line", "read"),
    [
        ("floor.txt", "1 aa 0 0 -60\n\n2 aa 0 x -60\n", 3, read_uw_floor),
        ("floor.txt", "1 aa 0 0 -60\n2 aa 0 inf -60\n", 2, read_uw_floor),
        ("floor.txt", "1 aa 0 0 -60\n2 aa 0 1\n", 2, read_uw_floor),
        ("traces/a.txt", TRACE + "2000\tTYPE_WIFI\tn\taa\t-50\n", 3, lambda p: read_indoor20(p.parents[1])),
        ("traces/a.txt", TRACE.replace("5\n", "-inf\n"), 2, lambda p: read_indoor20(p.parents[1])),
        ("layout.csv", "x,y\n1,2\n\n3,nan\n", 4, lambda p: read_flat(p.parent)),
        ("layout.csv", "x,y\n1,2\n3,\n", 3, lambda p: read_flat(p.parent)),
        ("layout.csv", "x,y\n1,2\n3,x\n", 3, lambda p: read_flat(p.parent)),
        ("01/trn01rss.csv.gz", "-50,-60\n-50\n", 2, lambda p: read_uji_library(p.parents[1], "01")),
        ("01/trn01rss.csv.gz", "-50,-60\n-50,1e400\n", 2, lambda p: read_uji_library(p.parents[1], "01")),
        ("Exp1_1router.csv", "x,y,rssi\n1,2,-50\n1,2,-\n", 3, lambda p: read_authors_walk(p.parent, 1)),
        ("Exp1_1router.csv", "x,y,rssi\n1,2,-50\n1,2\n", 3, lambda p: read_authors_walk(p.parent, 1)),
    ],
)
def test_the_faulty_line_of_a_file_is_named(tmp_path, name, content, line, read):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(gzip.compress(content.encode()) if name.endswith(".gz") else content.encode())
    with pytest.raises(DataError, match=rf"{path.name}, line {line}: "):
        read(path)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("calib3_scan.txt.gz", "1.0\n[0 1]\n[100 x]\n", "calib3_scan.txt.gz, line 3: "),
        ("calib3_scan.txt.gz", "1.0\n[0 1]\n[100 inf]\n", "calib3_scan.txt.gz, line 3: "),
        ("calib3_scan.txt.gz", "2.0\n[0]\n[100]\n1.0\n[0]\n[100]\n", "scan.txt.gz, line 4: time 1.000 follows 2.000"),
        (
            "calib3_scan.txt.gz",
            "1.0\n[0\n 1]\n",
            r"line 3: the file ends where ranges in brackets should follow; fetch",
        ),
        ("calib3_scan.txt.gz", "1.0\n[0]\n[100]\n2.0\n", "scan.txt.gz, line 4: the file ends where angles in brackets"),
        ("calib3_scan.txt.gz", "1.0\n[0]\n[1\n 00", r"scan.txt.gz, line 3: expected ranges in brackets; got '\[1'"),
        ("calib3_scan.txt.gz", "1.0\n[0]\n2.0\n[0]\n[100]\n", r"scan.txt.gz, line 3: expected ranges .*; got '2\.0'"),
        ("calib3_scan.txt.gz", "1.0\n[0 1]\n[100]\n", r"line 3: 1 ranges, where line 2 has 2 angles; fetch the file"),
        ("calib3_scan.txt.gz", "html\n", r"scan.txt.gz, line 1: expected a time in unix seconds; got 'html'"),
        ("calib3_scan.txt.gz", "", r"scan.txt.gz holds no scans: expected a time, angles and ranges for each; fetch"),
        ("calib3_motion.txt.gz", "1.0,stop,0\n2.0,left\n", "calib3_motion.txt.gz, line 2: "),
        ("calib3_motion.txt.gz", "1.0,stop,0\n2.0,left,inf\n", "calib3_motion.txt.gz, line 2: "),
        ("calib3_motion.txt.gz", "2.0,stop,0\n1.0,left,0.1\n", "motion.txt.gz, line 2: time 1.000 follows 2.000"),
        (
            "calib3_df.csv.gz",
            "ts,x,y,rssi_3,rssi_4,rssi_5,rssi_8,rssi_10,rssi_11\n1,,2,3,4,5,6,7,8\n",
            "csv.gz, line 2: ",
        ),
    ],
)
def test_the_faulty_line_of_a_drive_is_named(tmp_path, name, content, expected):
    whole = {"calib3_scan.txt.gz": "1.0\n[0]\n[100]\n", "calib3_motion.txt.gz": "1.0,stop,0\n"}
    for file, text in {**whole, name: content}.items():
        (tmp_path / file).write_bytes(gzip.compress(text.encode()))
    with pytest.raises(DataError, match=expected):
        read_ble_drive(tmp_path, "calib3", 90, 12.0)


def test_an_access_point_without_a_place_is_named_by_its_line(tmp_path):
    header, row = "ECoord,NCoord,FloorID,SceneID,PhoneID,SampleTimes,aa\n", "1,2,4,1,1,1,-50\n"
    (tmp_path / "Training_CETC331.csv.gz").write_bytes(gzip.compress((header + row).encode()))
    (tmp_path / "aps_CETC331.csv").write_text(
        "ECoord,NCoord,FloorID,Attribute_2.4,Attribute_5\n1,2,4,x,y\n1,2,,aa,bb\n"
    )
    with pytest.raises(DataError, match=r"aps_CETC331.csv, line 3: a value is missing"):
        read_sod(tmp_path, "CETC331")


@pytest.mark.parametrize(
    ("name", "header", "read"),
    [
        ("calibration_df.csv.gz", "ts,x,y," + ",".join(f"rssi_{k}" for k in range(1, 7)), read_ble_run),
        ("Training_CETC331.csv.gz", "ECoord,NCoord,FloorID,SceneID,PhoneID,SampleTimes,aa", read_sod),
    ],
)
def test_a_table_of_a_header_alone_is_a_data_error(tmp_path, name, header, read):
    (tmp_path / name).write_bytes(gzip.compress(header.encode() + b"\n"))
    (tmp_path / "aps_CETC331.csv").write_text("ECoord,NCoord,FloorID,Attribute_2.4,Attribute_5\n1,2,0,aa,bb\n")
    with pytest.raises(DataError, match="holds no rows"):
        read(tmp_path, name.removesuffix(".csv.gz").split("_")[-1 if read is read_sod else 0])


def test_empty_lines_of_a_table_are_left_out(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\r\n\r\n1,2\r\n\r\n")
    assert read_table(tmp_path / "a.csv") == (["a", "b"], [["1", "2"]], [3])


@needs_data
def test_surveys_have_the_documented_sizes():
    cetc = read_sod(DATA / "wifi" / "sod", "CETC331")
    assert cetc.rssi_dbm.shape == (955, 52)
    assert cetc.is_high_band.sum() == 26
    assert read_sod(DATA / "wifi" / "sod", "SYL").rssi_dbm.shape == (296, 46)
    assert len(read_uji_library(DATA / "wifi" / "uji_lib", "13").position_m) == 576
    robot = read_uw_floor(DATA / "wifi" / "uw_floor" / "uw-floor.txt")
    assert robot.rssi_dbm.shape == (394, 30)
    assert np.isfinite(robot.rssi_dbm).sum(axis=1).mean() == pytest.approx(14, abs=0.1)


@needs_data
def test_fresh_phone_scans_hold_as_many_addresses_as_documented():
    for floor, expected in (("site1_B1", 74), ("site2_F6", 114)):
        survey = read_indoor20(DATA / "indoor20" / floor)
        assert np.isfinite(survey.rssi_dbm).sum(axis=1).mean() == pytest.approx(expected, abs=1.0)


@needs_data
def test_runs_of_the_flat_lie_inside_its_outline():
    import shapely

    folder = DATA / "wifi" / "ble_lidar"
    outline = shapely.Polygon(read_flat(folder).outline_m).buffer(0.2)
    for run in ("calibration", "calib3", "calib4"):
        inside = shapely.contains_xy(outline, read_ble_run(folder, run).position_m)
        assert inside.mean() > 0.95


@needs_data
def test_the_last_two_walks_of_the_calibration_are_the_other_runs_and_the_first_two_are_not():
    folder = DATA / "wifi" / "ble_lidar"
    calibration = read_ble_run(folder, "calibration")
    assert np.unique(calibration.walk).tolist() == [0, 1, 2, 3]
    begun_s = read_numbers(folder / "calibration_df.csv.gz", ("ts",))[0, 0] * 1e-9
    for walk, run in ((2, "calib3"), (3, "calib4")):
        own_s = read_numbers(folder / f"{run}_df.csv.gz", ("ts",))[:, 0] * 1e-9 - begun_s
        apart_s = np.abs(calibration.time_s[:, None] - own_s[None]).min(axis=1)
        assert apart_s[calibration.walk == walk].max() < 0.01
        assert apart_s[calibration.walk < 2].min() > 60.0


@needs_data
def test_relations_of_the_intel_log_are_the_119_documented_ones():
    folder = DATA / "lidar" / "raw_odometry"
    log = read_scan_log(folder / "intel_gfs.json.gz")
    assert log.poses.shape == (910, 3)
    assert len(read_relations(folder / "intel.relations.gz", log).first) == 119


def test_another_building_of_the_format_is_read_and_an_unknown_one_named(tmp_path):
    header, row = "ECoord,NCoord,FloorID,SceneID,PhoneID,SampleTimes,aa\n", "1,2,4,1,1,1,-50\n"
    (tmp_path / "Training_HCXY_AP_30.csv").write_text(header + row)
    (tmp_path / "aps_HCXY.csv").write_text("ECoord,NCoord,FloorID,Attribute_2.4,Attribute_5\n1,2,4,aa,bb\n")
    assert read_sod(tmp_path, "HCXY").rssi_dbm.shape == (1, 1)
    with pytest.raises(DataError, match=r"has no Training_SYL\*\.csv\.gz of SODIndoorLoc; buildings there are HCXY"):
        read_sod(tmp_path, "SYL")


def test_a_walk_of_the_authors_may_have_any_number_of_readings(tmp_path):
    (tmp_path / "Exp1_1router.csv").write_text("x,y,rssi\n1,2,-40\n3,4,-50\n")
    assert read_authors_walk(tmp_path, 1).rssi_dbm.tolist() == [[-40.0], [-50.0]]
