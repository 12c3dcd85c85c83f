"""Bags written by rosbags are read to the same frames as the logs that they were made of."""

import math

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.scan_log import ScanLog, sensor_frames, spaced
from twc_env.datasets.ros.bag_file import is_bag, opened
from twc_env.datasets.ros.bag_log import _Track, list_topics, read_bag
from twc_env.datasets.ros.bag_writer import RobotRecording, _recorder, write_recording
from twc_env.datasets.ros.robot_topics import Wishes
from twc_env.errors import DataError
from twc_env.records.geometry import compose
from twc_env.records.scanner import Scanner

rosbags = pytest.importorskip("rosbags")
SUFFIXES = [".bag", ".mcap", ".db3", ""]


def path_of(count: int) -> np.ndarray:
    turn = np.linspace(0.0, 3.0, count)
    return np.stack([2.0 * np.cos(turn), 2.0 * np.sin(turn), turn + math.pi / 2], axis=1)


def recording(name="", count=12, scanner=None, seed=0, turn_rates=None, begun_s=1000.0) -> RobotRecording:
    scanner = scanner or Scanner(-math.pi / 2, math.radians(1.0), range_min_m=0.1, range_max_m=20.0)
    random = np.random.default_rng(seed)
    ranges = [np.round(random.uniform(0.5, 15.0, 181), 2) for _ in range(count)]
    ranges[0][:4] = math.nan, math.inf, 0.0, 25.0
    ranges[0][4] = 0.05
    times_s = begun_s + 0.2 * np.arange(count)
    return RobotRecording(name, times_s, path_of(count), ranges, scanner, turn_rates)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_scans_and_poses_come_back_from_every_kind_of_bag(tmp_path, suffix):
    robot = recording(scanner=Scanner(math.radians(-135), math.radians(1.5), (0.2, -0.1, 3.0), 0.1, 20.0))
    path = tmp_path / f"a{suffix}"
    write_recording(path, [robot])
    assert is_bag(path)
    (found,) = read_bag(path)
    assert found.log.times_s == pytest.approx(robot.times_s, abs=1e-6)
    assert found.mount == pytest.approx([0.2, -0.1, 3.0 - 0.0])
    assert found.log.poses == pytest.approx(compose(robot.odometry, np.array([0.2, -0.1, 3.0])), abs=1e-9)
    assert found.log.beam_angles_rad == pytest.approx(np.radians(-135 + 1.5 * np.arange(181)), abs=1e-9)
    assert np.isinf(found.log.ranges_of(0)[:5]).all()
    assert (found.log.ranges_of(1) == robot.ranges_m[1]).all()


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_bag_of_a_carmen_log_gives_the_frames_of_the_log(tmp_path, suffix):
    random = np.random.default_rng(1)
    lines = []
    for k, (x, y, turn) in enumerate(path_of(40)):
        told = " ".join(f"{v:.2f}" for v in random.uniform(0.5, 40.0, 180))
        lines.append(f"FLASER 180 {told} {x:.6f} {y:.6f} {turn:.6f} 0 0 0 {1000 + 0.5 * k:.6f} host 0")
    (tmp_path / "a.log").write_text("\n".join(lines))
    log = read_any_log(tmp_path / "a.log")
    scanner = Scanner(math.radians(-90.0), math.radians(1.0), range_max_m=81.0)
    write_recording(tmp_path / f"a{suffix}", [RobotRecording("", log.times_s, log.poses, list(log.ranges_m), scanner)])
    (found,) = read_bag(tmp_path / f"a{suffix}")
    assert np.array_equal(spaced(log), spaced(found.log))
    for direct, ours in zip(sensor_frames(log, 360, 20.0), sensor_frames(found.log, 360, 20.0), strict=True):
        assert np.array_equal(direct.ranges_m, ours.ranges_m)
        assert ours.odometry == pytest.approx(direct.odometry, abs=1e-9)
        assert ours.time_s == pytest.approx(direct.time_s, abs=1e-6)


def test_robots_are_told_apart_by_namespace_and_each_has_its_own_scanner(tmp_path):
    scanners = [Scanner(-1.0, 0.02, (0.3, 0.0, 0.0), 0.1, 20.0), Scanner(0.5, -0.02, (-0.1, 0.0, math.pi), 0.1, 20.0)]
    write_recording(tmp_path / "a.bag", [recording(f"r{k}", scanner=s, seed=k) for k, s in enumerate(scanners)])
    found = read_bag(tmp_path / "a.bag")
    assert [robot.name for robot in found] == ["r0", "r1"]
    assert [robot.mount[0] for robot in found] == pytest.approx([0.3, -0.1])
    for robot, scanner in zip(found, scanners, strict=True):
        expected = scanner.first_rad + scanner.step_rad * np.arange(181)
        assert robot.log.beam_angles_rad == pytest.approx(expected, abs=2e-6)


def test_odometry_that_is_silent_while_the_robot_drives_is_said():
    """A driver that was down for 5 s and began anew bent a map by 25 m, in silence."""
    times_s, poses = 1000.0 + 0.2 * np.arange(60), path_of(60)
    for kept, said in ((np.r_[0:20, 45:60], "no odometry for 5.2 s, 3.8 s after the first scan: 26 scans"), (..., "")):
        track = _Track(times_s[kept], times_s[kept], poses[kept], 0)
        found = track.silence(times_s, times_s[kept])
        assert found.startswith(said) and bool(found) == bool(said)
    standing = _Track(times_s[::20], times_s[::20], np.zeros((3, 3)), 0)
    assert not standing.silence(times_s, times_s[::20])
    assert not track.silence(times_s[:1], times_s)


def test_a_gyro_gives_the_turn_rates_of_frames(tmp_path):
    rates = np.linspace(-0.5, 0.5, 12)
    write_recording(tmp_path / "a.mcap", [recording(turn_rates=rates)])
    (found,) = read_bag(tmp_path / "a.mcap")
    frames = sensor_frames(found.log, 360, 20.0)
    assert [frame.turn_rate_rad_s for frame in frames[1:]] == pytest.approx(rates[1:], abs=1e-6)


def test_a_scan_that_takes_time_names_its_sweep(tmp_path):
    scanner = Scanner(-1.0, 0.01, range_min_m=0.1, range_max_m=20.0, sweep_s=0.09)
    robot = recording(scanner=scanner)
    write_recording(tmp_path / "a.mcap", [robot])
    (found,) = read_bag(tmp_path / "a.mcap")
    assert found.log.sweep_s == pytest.approx(0.09, rel=1e-6)
    assert found.log.times_s == pytest.approx(robot.times_s, abs=1e-6)
    frame = sensor_frames(found.log, 360, 20.0)[1]
    assert frame.scanner.sweep_s == found.log.sweep_s
    assert len(frame.ranges_m) == 181


def message_bag(path, odometry=True, transforms=True, stamps=True, truth=False, flipped=False, cloud=False):
    """A bag of single messages, for what the drivers' writer does not do."""
    robot = recording()
    with _recorder(path) as out:
        if transforms and not flipped:
            out.transform(1000.0, "/tf_static", "base_link", "laser", np.array([0.1, 0.0, 0.0]))
        if flipped:
            turned = out.kind("geometry_msgs/msg/Quaternion")(x=1.0, y=0.0, z=0.0, w=0.0)
            moved = out.kind("geometry_msgs/msg/Transform")(
                translation=out.point(np.zeros(3), "Vector3"), rotation=turned
            )
            stamped = out.kind("geometry_msgs/msg/TransformStamped")(
                header=out.header(1000.0, "base_link"), child_frame_id="laser", transform=moved
            )
            out.add(1000.0, "/tf_static", "tf2_msgs/msg/TFMessage", transforms=[stamped])
        for k, (time_s, pose) in enumerate(zip(robot.times_s, robot.odometry, strict=True)):
            if odometry:
                out.odometry(time_s, "/odom", "odom", "base_link", pose)
            if truth:
                out.odometry(time_s, "/base_pose_ground_truth", "map", "base_link", pose + 5.0)
            out.transform(time_s, "/tf", "odom", "base_link", pose)
            out.add(
                time_s, "/scan", "sensor_msgs/msg/LaserScan", header=out.header(time_s if stamps else 0.0, "laser"),
                angle_min=-1.0, angle_max=1.0, angle_increment=2.0 / 180, time_increment=0.0, scan_time=0.0,
                range_min=0.1, range_max=20.0, ranges=robot.ranges_m[k].astype(np.float32),
                intensities=np.zeros(0, np.float32),
            )  # fmt: skip
    return robot


def test_tf_is_the_odometry_of_a_bag_without_an_odometry_topic(tmp_path):
    robot = message_bag(tmp_path / "a.bag", odometry=False)
    (found,) = read_bag(tmp_path / "a.bag")
    assert found.topics.odometry is None
    assert found.log.poses == pytest.approx(compose(robot.odometry, np.array([0.1, 0.0, 0.0])), abs=1e-6)
    with pytest.raises(DataError, match="has no topic '/odometry' of nav_msgs/Odometry for --odom-topic"):
        read_bag(tmp_path / "a.bag", Wishes(odometry=("/odometry",)))


def test_scans_without_stamps_are_at_the_times_of_reception_which_is_said(tmp_path):
    robot = message_bag(tmp_path / "a.mcap", stamps=False)
    (found,) = read_bag(tmp_path / "a.mcap")
    assert found.log.times_s == pytest.approx(robot.times_s, abs=1e-6)
    assert any("times of reception are used" in note for note in found.notes)


def test_true_poses_are_no_odometry(tmp_path):
    message_bag(tmp_path / "a.mcap", truth=True)
    (found,) = read_bag(tmp_path / "a.mcap")
    assert found.topics.odometry == "/odom"
    (chosen,) = read_bag(tmp_path / "a.mcap", Wishes(odometry=("/base_pose_ground_truth",)))
    assert chosen.topics.odometry == "/base_pose_ground_truth"


def test_a_scanner_upside_down_has_beams_the_other_way_round(tmp_path):
    message_bag(tmp_path / "a.mcap", flipped=True)
    (found,) = read_bag(tmp_path / "a.mcap")
    assert found.log.beam_angles_rad[[0, -1]] == pytest.approx([1.0, -1.0], abs=1e-5)
    assert any("upside down" in note for note in found.notes)


def test_an_unknown_mounting_is_said(tmp_path):
    message_bag(tmp_path / "a.mcap", transforms=False)
    (found,) = read_bag(tmp_path / "a.mcap")
    assert any("taken to be at the robot's centre" in note for note in found.notes)


def test_topics_are_listed_with_rates_frames_and_uses(tmp_path, capsys):
    write_recording(tmp_path / "a.mcap", [recording("r0"), recording("r1", seed=1)])
    rows = {row["topic"]: row for row in list_topics(tmp_path / "a.mcap")}
    assert rows["/r0/scan"]["used for"] == "scan of r0"
    assert rows["/r1/odom"]["used for"] == "odometry of r1"
    assert rows["/r0/odom"]["frame"] == "r0/odom->r0/base_link"
    assert rows["/r0/scan"]["rate [Hz]"] == pytest.approx(5.0, rel=0.01)
    assert main(["replay", str(tmp_path / "a.mcap"), "--list"]) == 0
    assert "sensor_msgs/LaserScan" in capsys.readouterr().out


def test_a_bag_without_scans_is_refused_with_what_it_has(tmp_path):
    with _recorder(tmp_path / "a.bag") as out:
        out.odometry(1.0, "/odom", "odom", "base_link", np.zeros(3))
    with pytest.raises(DataError, match="has no topic of sensor_msgs/LaserScan with messages, but nav_msgs/Odometry"):
        read_bag(tmp_path / "a.bag")


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.bag", b"#ROSBAG V2.0\nxx"), ("a.mcap", b"\x89MCAP0\r\n12"), ("a.db3", b"SQLite format 3\x00")],
)
def test_a_damaged_bag_is_refused_in_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match="cannot read the bag"), opened(tmp_path / name):
        pass


def test_without_rosbags_the_command_that_installs_it_is_told(tmp_path, monkeypatch):
    import sys

    write_recording(tmp_path / "a.bag", [recording()])
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(DataError, match=r"needs `pip install 'twc_env\[ros\]'`"):
        read_bag(tmp_path / "a.bag")


def test_a_dense_log_is_thinned_and_a_sparse_one_is_not():
    count = 400
    poses = np.column_stack([0.02 * np.arange(count), np.zeros(count), np.zeros(count)])
    log = ScanLog(np.arange(count) * 0.1, poses, np.ones((count, 4)), np.arange(4.0))
    used = spaced(log, [7])
    assert {0, 7, count - 1} <= set(used.tolist())
    assert np.diff(poses[used, 0]).max() < 0.121
    assert len(used) < 90
    sparse = ScanLog(log.times_s, 30 * poses, log.ranges_m, log.beam_angles_rad)
    assert len(spaced(sparse)) == count


def test_metadata_that_nests_deeply_is_refused_at_once(tmp_path):
    write_recording(tmp_path / "folder", [recording()])
    metadata = tmp_path / "folder" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("version:", "extra: " + "[" * 3000 + "\n  version:", 1))
    with pytest.raises(DataError, match="nests its lists too deeply; run `ros2 bag reindex"):
        read_bag(tmp_path / "folder")


def test_a_topic_of_two_types_is_read_by_its_own(tmp_path):
    write_recording(tmp_path / "folder", [recording("a", turn_rates=np.full(12, 0.1))])
    metadata = tmp_path / "folder" / "metadata.yaml"
    text = metadata.read_text()
    assert "/tf_static" in text and "/a/imu" in text
    metadata.write_text(text.replace("/a/imu", "/tf_static"))
    (found,) = read_bag(tmp_path / "folder")
    assert found.mount == pytest.approx(np.zeros(3)) and found.log.turned_rad is None
