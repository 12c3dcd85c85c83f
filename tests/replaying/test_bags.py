"""The same trajectories from a bag as from the logs that it was made of, for every kind of bag."""

import json

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.__main__ import main
from twc_env.config import EnvConfig, override
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.ros.bag_file import ODOMETRY, opened
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.datasets.sample import sample_files
from twc_env.records.geometry import compose
from twc_env.records.scanner import Scanner
from twc_env.replaying.inputs import Asked, input_of, read_input
from twc_env.replaying.outputs import write_paths
from twc_env.replaying.run import run
from twc_env.replaying.simulated_log import simulate

pytest.importorskip("rosbags")


def paths_of(source) -> list[np.ndarray]:
    return [path.estimated for path in run(source, source.config).paths()]


@needs_data
@pytest.mark.parametrize(
    ("name", "beams", "suffix"),
    [("orebro", 181, ".bag"), ("orebro", 181, ".mcap"), ("freiburg-101", 360, ".db3")],
)
def test_a_carmen_log_as_a_bag_has_the_same_trajectory(tmp_path, name, beams, suffix):
    path = DATA / "lidar" / "carmen" / f"{name}-corrected.log.gz"
    log, first = read_any_log(path), slice(120)
    log = ScanLog(1000.0 + np.arange(120), log.poses[first], log.ranges_m[first], log.beam_angles_rad)
    step = 180.0 / (beams - beams % 2)
    scanner = Scanner(np.radians(-90.0), np.radians(step), range_max_m=100.0)
    bag = tmp_path / f"a{suffix}"
    write_recording(bag, [RobotRecording("", log.times_s, log.poses, list(log.ranges_m), scanner)])
    direct, ours = paths_of(input_of([log], [np.zeros(3)], Asked())), paths_of(read_input([bag], Asked()))
    assert ours[0] == pytest.approx(direct[0], abs=1e-6)


def test_logs_of_one_robot_on_two_days_are_two_robots(tmp_path):
    """The trajectory of the second stood in the place of the first, in a file named after both."""
    log, bags = read_any_log(sample_files().logs[0]).at(slice(0, 5)), []
    for day, name in enumerate(("husky", "husky", "jackal")):
        bags.append(tmp_path / f"{day}.bag")
        times_s, scanner = log.times_s + 86400.0 * day, Scanner(0.0, np.radians(2.0))
        write_recording(bags[-1], [RobotRecording(name, times_s, log.poses, list(log.ranges_m), scanner)])
    source = read_input(bags, Asked())
    assert source.names == ["husky_1", "husky_2", "jackal"]
    assert "several robots are called husky: this one is husky_2 from here on" in source.notes
    replay = run(source, source.config)
    write_paths(tmp_path, replay)
    assert len(list((tmp_path / "trajectories").iterdir())) == 6
    assert read_input(bags[1:], Asked()).names == ["husky", "jackal"]


@pytest.fixture(scope="module")
def team():
    """Three robots: 360 degrees; 270 degrees, on the front; 180 degrees, looking back and clockwise. What their drivers
    publish, and the paths by the logs themselves."""
    config = override(EnvConfig(), {"map": "twin-01", "robots": 3, "max_cycles": 150, "lidar.beam_count": 180})
    log = simulate(config, 3)
    scanners = [
        Scanner(0.0, np.radians(2.0), (0.0, 0.0, 0.0), 0.05, 10.0),
        Scanner(np.radians(-136.0), np.radians(2.0), (0.2, 0.0, 0.0), 0.05, 10.0),
        Scanner(np.radians(90.0), np.radians(-2.0), (-0.1, 0.05, np.pi), 0.05, 10.0),
    ]
    robots, logs, mounts = [], [], []
    for robot, (scanner, beams) in enumerate(zip(scanners, (180, 137, 91), strict=True)):
        own = log.frames[robot]
        angles_deg = np.rint(np.degrees(scanner.first_rad)) + np.rint(np.degrees(scanner.step_rad)) * np.arange(beams)
        slots = (np.rint((angles_deg + np.degrees(scanner.mount[2])) / 2.0) % 180).astype(int)
        ranges = np.round([frame.ranges_m[slots] for frame in own], 5)
        ranges[ranges >= 10.0] = np.inf
        odometry, times_s = log.odometry(robot), log.times_s(robot)
        robots.append(RobotRecording(f"robot_{robot}", times_s, odometry, list(ranges), scanner))
        mounts.append(np.array(scanner.mount))
        logs.append(ScanLog(times_s, compose(odometry, mounts[-1]), ranges, np.radians(angles_deg)))
    direct = input_of(logs, mounts, Asked(), [(f"robot_{k}", [], True) for k in range(3)])
    return robots, np.array(mounts), paths_of(direct)


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ""])
def test_a_team_of_different_scanners_and_mountings_has_the_same_trajectories(tmp_path, team, suffix):
    robots, mounts, direct = team
    write_recording(tmp_path / f"a{suffix}", robots)
    ours = read_input([tmp_path / f"a{suffix}"], Asked())
    assert ours.mounts == pytest.approx(mounts, abs=1e-9)
    for first, second in zip(direct, paths_of(ours), strict=True):
        assert second == pytest.approx(first, abs=1e-6)


def test_the_sample_is_replayed_and_its_results_come_back_from_a_bag(tmp_path, capsys):
    bag, out = tmp_path / "result.bag", tmp_path / "out"
    arguments = ["replay", "sample", "--out", str(out), "--bag", str(bag), "--format", "svg", "--json"]
    assert main([*arguments, str(tmp_path / "figures.json")]) == 0
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["groups"] == [[0, 1]]
    names = {path.name for path in out.iterdir()}
    assert {"map.svg", "map.pgm", "map.yaml", "pose_graph.g2o", "trajectories", "table.csv", "replay.html"} <= names
    assert "end heading [deg]" in (out / "table.csv").read_text()
    times_s, poses = read_tum(out / "trajectories" / "robot_1_estimated.tum")
    with opened(bag) as found:
        topics = {topic.name: topic.count for topic in found.topics}
        own = [m for name, _, m in found.messages(["/robot_1/slam/odometry"], [ODOMETRY])]
    assert topics["/map"] == 1
    assert topics["/robot_0/slam/path"] == 1
    assert topics["/tf"] == 2 * sum(row["scans"] for row in figures["robots"])
    assert len(own) == len(times_s)
    assert own[-1].pose.pose.position.x == pytest.approx(poses[-1, 0], abs=1e-6)
    assert main(["replay", "sample", "--bag", str(bag)]) == 2
    assert "bags are not overwritten" in capsys.readouterr().err
