import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.carmen_log import read_any_log, read_carmen_log
from twc_env.datasets.logs.scan_log import ScanLog, onto_circle, read_scan_log, sensor_frames
from twc_env.errors import DataError, TwcError
from twc_env.records.geometry import compose
from twc_env.records.messages import UNSEEN_M
from twc_env.slam.matching.scan_matching import scan_points
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.world.building.floorplan_file import read_floorplan

LINE = "FLASER 3 1.0 2.0 81.9 4 5 0.5 9 9 9 7.25 host 7.3"


def test_a_line_of_carmen_is_a_scan_with_its_pose(tmp_path):
    path = tmp_path / "drive.log"
    path.write_text(f"# a log\nODOM 1 2 3 0 0 0 5 host 5\n{LINE}\n")
    log = read_carmen_log(path)
    assert log.ranges_m.tolist() == [[1.0, 2.0, 81.9]]
    assert log.poses.tolist() == [[4.0, 5.0, 0.5]] and log.times_s.tolist() == [7.25]
    assert np.degrees(log.beam_angles_rad) == pytest.approx([-90.0, 0.0, 90.0])


ROBOTLASER = "ROBOTLASER1 0 -0.5 1.0 0.5 30 0.01 0 3 1.0 2.0 30.0{} 4 5 0.5 3 5 0.5 0 0 1 1{} 7.25 host 7.3"
NEWER = ROBOTLASER.format("", "")


@pytest.mark.parametrize("parts", [("", ""), (" 0", " 9"), (" 2 0.1 0.2", " 9")])
def test_a_line_of_newer_carmen_says_where_its_beams_point(tmp_path, parts):
    path = tmp_path / "drive.log"
    path.write_text(f"ODOM 1 2 3 0 0 0 5 host 5\n{ROBOTLASER.format(*parts)}\n{LINE}\n")
    log = read_carmen_log(path)
    assert log.ranges_m.tolist() == [[1.0, 2.0, np.inf]]
    assert log.poses.tolist() == [[4.0, 5.0, 0.5]] and log.times_s.tolist() == [7.25]
    assert log.beam_angles_rad.tolist() == [-0.5, 0.0, 0.5]
    (frame,) = sensor_frames(log, 8, 20.0)
    assert frame.ranges_m.tolist() == [2.0, *[UNSEEN_M] * 6, 1.0]


def test_what_is_no_carmen_log_is_answered_with_the_way_for_other_logs(tmp_path):
    path = tmp_path / "drive.bag"
    path.write_bytes(b"#ROSBAG V2.0")
    with pytest.raises(
        DataError,
        match=r"expected lines FLASER, ROBOTLASER1, or RAWLASER1 with ODOM; of other formats `write_frame_log` makes",
    ):
        read_carmen_log(path)


@pytest.mark.parametrize("text", [f"# Büro\n{LINE}\n", "  " + LINE.replace(" ", "\t") + "\r\n"])
def test_carmen_may_have_comments_in_any_encoding_indented_lines_and_tabs(tmp_path, text):
    path = tmp_path / "drive.log"
    path.write_bytes(text.encode("latin-1"))
    assert read_carmen_log(path).ranges_m.tolist() == [[1.0, 2.0, 81.9]]


@pytest.mark.parametrize(
    ("first", "last", "fault"),
    [
        (LINE, LINE[:20], "it is cut off"),
        (LINE, LINE.replace("3 1.0", "2"), "2 beams, where those before have 3"),
        (LINE, LINE.replace("2.0", "2.x"), "could not convert string to float"),
        (LINE, " ".join([*LINE.split()[:5], "nan", *LINE.split()[6:]]), "its pose or its time is not finite"),
        (NEWER, NEWER[:60], "it is cut off"),
        (NEWER, ROBOTLASER.format(" 2 0.1", " 9"), "it is cut off"),
    ],
)
def test_a_line_of_carmen_that_is_no_scan_is_named(tmp_path, first, last, fault):
    path = tmp_path / "drive.log"
    path.write_text(f"# a log\n{first}\n{last}\n")
    with pytest.raises(DataError, match=f"line 3 is not a scan: {fault}.*; fix or delete it"):
        read_carmen_log(path)


def test_a_log_of_deep_nesting_is_refused(tmp_path):
    path = tmp_path / "drive.json"
    path.write_text("[" * 100_000)
    with pytest.raises(DataError, match="is not a scan log"):
        read_scan_log(path)


def test_a_scan_of_the_front_says_nothing_of_the_back():
    scan = onto_circle(np.array([1.0, 12.0, 81.9]), np.deg2rad([-90.0, 0.0, 90.0]), 8, 10.0)
    assert scan.tolist() == [10.0, *[UNSEEN_M] * 5, 1.0, UNSEEN_M]


def test_of_beams_that_share_a_direction_the_nearest_counts():
    scan = onto_circle(np.array([3.0, 2.0, 0.0]), np.deg2rad([1.0, -1.0, 90.0]), 4, 10.0)
    assert scan[:2].tolist() == [2.0, UNSEEN_M]


def test_the_engine_neither_clears_nor_matches_what_was_not_seen():
    scan = onto_circle(np.full(180, 3.0), np.deg2rad(np.arange(180.0) - 90.0), 360, 10.0)
    assert scan_points(scan, 10.0)[:, 0].min() > -0.06 and len(scan_points(scan, 10.0)) == 180
    grid = OccupancyGrid(0.1, 10.0, 360)
    grid.integrate(np.zeros((1, 3)), scan[None])
    rows, columns = np.nonzero(grid.log_odds)
    known = grid.snapshot().centre_of(np.stack([rows, columns], axis=-1))
    assert known[:, 0].min() > -0.16 and (grid.log_odds < 0).sum() == pytest.approx(0.5 * np.pi * 9 * 100, rel=0.06)


def test_odometry_and_gyro_of_the_frames_give_the_path_back():
    poses = np.array([[1.0, 2.0, 0.3], [1.5, 2.1, 0.9], [1.2, 2.6, 2.0]])
    log = ScanLog(np.array([4.0, 6.0, 6.0]), poses, np.ones((3, 3)), np.zeros(3))
    frames = sensor_frames(log, 8, 10.0, [0, 1, 2], robot=1)
    pose, heading = poses[0], poses[0, 2]
    for before, frame in zip([frames[0], *frames], frames, strict=False):
        pose = compose(pose, frame.odometry)
        heading += frame.turn_rate_rad_s * (frame.time_s - before.time_s)
    assert pose == pytest.approx(poses[-1]) and heading == pytest.approx(2.0)
    assert [f.step for f in frames] == [0, 1, 2] and frames[2].time_s > frames[1].time_s and frames[0].robot == 1


@needs_data
def test_both_forms_of_the_intel_log_hold_the_same_scans():
    folder = DATA / "lidar"
    carmen = read_carmen_log(folder / "carmen" / "intel-corrected.log.gz")
    log = read_scan_log(folder / "raw_odometry" / "intel_corrected_log.json.gz")
    assert carmen.ranges_m.shape == log.ranges_m.shape == (910, 180)
    assert carmen.ranges_m[100] == pytest.approx(log.ranges_m[100], abs=0.01)
    assert carmen.beam_angles_rad == pytest.approx(log.beam_angles_rad)


@pytest.mark.parametrize("name", ["none.log", "none.json"])
def test_a_log_that_is_not_there_is_not_said_to_be_of_another_kind(name, tmp_path):
    with pytest.raises(DataError, match=r"^cannot read"):
        read_any_log(tmp_path / name)


def test_one_scan_of_very_many_beams_does_not_fill_up_all_others(tmp_path):
    def line(beams: int) -> str:
        ranges = " ".join(["1.0"] * beams)
        return f"ROBOTLASER1 0 -0.5 1.0 0.001 30 0.01 0 {beams} {ranges} 0 4 5 0.5 3 5 0.5 0 0 1 1 9 7.25 host 7.3\n"

    path = tmp_path / "drive.log"
    path.write_text(line(3) * 1000 + line(2000))
    with pytest.raises(DataError, match="scans of 3 to 2000 beams, mostly of few: they are of different scanners"):
        read_carmen_log(path)


@pytest.mark.parametrize("read", [read_scan_log, read_floorplan])
def test_json_of_millions_of_lists_is_refused_before_it_is_read(tmp_path, monkeypatch, read):
    monkeypatch.setattr("twc_env.records.json_values.LISTS_MAX", 100)
    path = tmp_path / "a.json"
    path.write_text('{"a": [' + "[]," * 200 + "1]}")
    with pytest.raises(TwcError, match="it holds 202 lists and tables, where 100 are possible; cut it into parts"):
        read(path)
