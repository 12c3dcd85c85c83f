"""What the settings, names and team of a replay's input become in its output."""

import dataclasses

import numpy as np
import pytest

from twc_env import parallel_env
from twc_env.__main__ import main
from twc_env.commands.replay import _maps_told
from twc_env.config import EnvConfig, override
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.frame_log import read_truth_log, write_frame_log
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.ros.bag_file import opened
from twc_env.datasets.sample import sample_files
from twc_env.errors import ConfigError
from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.pictures import log_picture
from twc_env.replaying.inputs import Asked, input_of, read_input
from twc_env.replaying.outputs import write_bag, write_maps, write_paths
from twc_env.replaying.run import run


@pytest.mark.parametrize(("asked_m", "range_max_m"), [(None, 20.0), (8.0, 8.0), (29.0, 29.0)])
def test_returns_are_used_as_far_as_is_asked(asked_m, range_max_m):
    """Those beyond were drawn as a wall at 20 m when the engine was told to believe more."""
    log = read_any_log(sample_files().logs[0])
    far = dataclasses.replace(log, ranges_m=np.full_like(log.ranges_m, 25.0))
    source = input_of([far], [np.zeros(3)], Asked(range_max_m=asked_m))
    assert source.config.lidar.range_max_m == range_max_m
    seen = source.steps[0][0].ranges_m
    assert seen.max() == pytest.approx(min(25.0, range_max_m))


def test_a_range_that_logs_have_no_returns_of_is_refused(refusal):
    logs = [str(log) for log in sample_files().logs]
    assert "30 m and more are no return; use at most 30" in refusal(
        main, ["replay", *logs, "--set", "lidar.range_max_m=80"]
    )
    with pytest.raises(ConfigError, match="at most 30"):
        input_of([read_any_log(logs[0])], [np.zeros(3)], Asked(range_max_m=80.0))


def test_odometry_that_never_moves_is_named_where_the_scans_change():
    """A map of two scans came out, and all others were said to be hardly apart from these."""
    log = read_any_log(sample_files().logs[0])
    dead = dataclasses.replace(log, poses=np.zeros_like(log.poses))
    standing = dataclasses.replace(dead, ranges_m=np.repeat(log.ranges_m[:1], len(log.times_s), axis=0))
    standing.ranges_m[::2, 40:100] = 1.0  # somebody walks by
    is_named = [
        any("the odometry of a never moves, but the scans show other places" in note for note in source.notes)
        for source in (input_of([each], [np.zeros(3)], Asked(), [("a", [], True)]) for each in (dead, standing, log))
    ]
    assert is_named == [True, False, False]


def test_a_way_without_scans_is_named():
    """A log without the scans of 80 s had a map bent by 3.6 m, in silence."""
    log = read_any_log(sample_files().logs[0])
    far = int(np.argmax(np.hypot(*(log.poses[20:, :2] - log.poses[20, :2]).T) > 5.5)) + 20
    gap = log.at(np.r_[0:21, far : len(log.times_s)])
    notes = ["".join(input_of([each], [np.zeros(3)], Asked()).notes) for each in (gap, log)]
    assert (
        f"by odometry without a scan, for {far - 20} s from 20.0 s after the log begins: the map may bend" in notes[0]
    )
    assert "without a scan" not in notes[1]


def test_trajectories_bear_the_names_of_the_robots(tmp_path):
    """A bag with /robot_1 and /robot_2 had the path of the second in robot_1_estimated.tum."""
    logs = [read_any_log(log) for log in sample_files().logs]
    source = input_of(logs, [np.zeros(3)] * 2, Asked(), [("/robot_1", [], True), ("/site/robot_2", [], True)])
    write_paths(tmp_path, run(source, source.config))
    names = {path.name for path in (tmp_path / "trajectories").iterdir()}
    assert names == {f"{name}_{kind}.tum" for name in ("robot_1", "site_robot_2") for kind in ("estimated", "odometry")}


def test_lines_of_the_engine_have_the_names_of_the_robots():
    logs = [read_any_log(log).at(slice(0, 3)) for log in sample_files().logs]
    bare, named = (input_of(logs, [np.zeros(3)] * 2, Asked(), [(name, [], True) for name in names])
                   for names in (("", ""), ("b", "1")))  # fmt: skip
    lines = ("no common map of robots 0, 1 and robot 1 after being carried (segment 2)", "lost robot 0 11%, robot 1 0%")
    assert [run(bare, bare.config).by_name(line) for line in lines] == list(lines)
    assert [run(named, named.config).by_name(line) for line in lines] == [
        "no common map of robots b, 1 and robot 1 after being carried (segment 2)", "lost robot b 11%, robot 1 0%",
    ]  # fmt: skip
    assert run(bare, bare.config).by_name("robots 0") == "robot 0"


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """A replay of a robot that is carried off after 30 s, and its true poses (frames, 3)."""
    folder = tmp_path_factory.mktemp("carried")
    settings = ["--robots", "1", "--steps", "600", "--set", "failure.kidnap_step=300"]
    assert main(["record", "--map", "gen:office:800:7", *settings, "--out", str(folder)]) == 0
    source = read_input([folder / "frames.npz"], Asked())
    return run(source, source.config), read_truth_log(folder / "truth.npz")[2][:, 0]


def test_poses_from_before_a_robot_was_carried_stand_in_a_file_of_their_own(carried, tmp_path):
    """One file had poses of two maps, each in the frame of its own."""
    replay, truth = carried
    write_paths(tmp_path, replay)
    written = {path.name: read_tum(path) for path in (tmp_path / "trajectories").iterdir()}
    assert set(written) == {f"robot_0_{kind}.tum" for kind in ("estimated", "odometry", "part_1_estimated")}
    (before_s, before), (since_s, since) = written["robot_0_part_1_estimated.tum"], written["robot_0_estimated.tum"]
    assert len(before_s) == 300 and before_s[-1] < since_s[0]
    for own, true in ((before, truth[:300]), (since, truth[300:])):
        assert absolute_trajectory_error_m(own, true) < 0.1
    assert absolute_trajectory_error_m(np.vstack([before, since]), truth) > 1.0  # they are two maps
    walked_m = sum(np.hypot(*np.diff(part[:, :2], axis=0).T).sum() for part in (before, since))
    assert replay.table()[0]["path [m]"] == pytest.approx(walked_m, abs=0.01)


def test_a_bag_has_no_poses_from_before_a_robot_was_carried(carried, tmp_path):
    pytest.importorskip("rosbags")
    write_bag(tmp_path / "slam.mcap", carried[0])
    with opened(tmp_path / "slam.mcap") as bag:
        counts = {topic.name: topic.count for topic in bag.topics}
    assert counts["/slam/odometry"] == 301 and counts["/tf"] == 301 + 601


def test_the_picture_has_each_part_of_a_carried_robot_s_path_in_its_own_map(carried):
    figure = log_picture._figure(carried[0])
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert [title.partition(" of floor")[2] for title in titles] == [" seen", ", robot 0 before being carried"]
    drawn = [max(len(line.get_xdata()) for line in axes.lines) for axes in figure.axes[:2]]
    assert sorted(drawn) == [300, 301]


def test_trajectories_and_maps_of_an_earlier_run_do_not_stay(carried, tmp_path):
    """They would look like those of further robots."""
    write_paths(tmp_path, carried[0])
    write_maps(tmp_path, carried[0].engine.team)
    assert (tmp_path / "map_2.yaml").exists()
    source = input_of([read_any_log(sample_files().logs[0])], [np.zeros(3)], Asked(), [("/other", [], True)])
    again = run(source, source.config)
    write_paths(tmp_path, again)
    write_maps(tmp_path, again.engine.team)
    names = {path.name for path in (tmp_path / "trajectories").iterdir()}
    assert names == {"other_estimated.tum", "other_odometry.tum"} and not list(tmp_path.glob("map_*"))


def test_frames_of_fewer_robots_than_their_settings_have_are_replayed_into_a_folder(tmp_path):
    env = parallel_env(map="twin-02", robots=2, max_cycles=30)
    env.reset(seed=0)
    steps = []
    while env.agents:
        env.step({agent: np.array([0.5, 0.1], np.float32) for agent in env.agents})
        steps.append([frame for frame in env.frames if frame.robot == 0])
    write_frame_log(tmp_path / "one.npz", override(EnvConfig(), {"robots": 3}), steps)
    assert main(["replay", str(tmp_path / "one.npz"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "replay.html").exists()


def test_a_place_in_an_old_map_found_by_scans_alone_is_told_as_such(tmp_path, capsys):
    first, second = map(str, sample_files().logs)
    assert main(["replay", first, "--save", str(tmp_path / "old.npz")]) == 0
    assert "by their scans alone" not in capsys.readouterr().out
    assert main(["replay", second, "--prior", str(tmp_path / "old.npz")]) == 0
    said = capsys.readouterr().out
    assert "in the old map   robot 0" in said and "by their scans alone" in said


def test_a_sample_by_a_preset_scanner_has_the_beams_of_the_preset(tmp_path):
    asked = ["data", "sample", "--map", "twin-02", "--robots", "1", "--steps", "20", "--out", str(tmp_path)]
    assert main([*asked, "--set", "lidar.preset=lds-01"]) == 0
    (log,) = [read_any_log(path) for path in tmp_path.iterdir() if path.name.startswith("robot_0.log")]
    assert log.ranges_m.shape[1] == 360


@pytest.mark.parametrize(("times", "is_odd"), [(1.0, False), (0.8, False), (57.3, True), (-1.0, True), (0.0175, True)])
def test_a_gyro_of_another_unit_or_sign_is_told(times, is_odd):
    log = read_any_log(sample_files().logs[0])
    gyro = dataclasses.replace(log, turned_rad=times * np.unwrap(log.poses[:, 2]))
    notes = input_of([gyro], [np.zeros(3)], Asked(), [("scout", [], True)]).notes
    told = [note for note in notes if "gyro of scout" in note]
    assert len(told) == is_odd and all("--imu-topic none" in note for note in told)


def test_maps_of_the_same_robot_are_told_together():
    before = "robot 0 before being carried"
    assert _maps_told(["robot 0"]) == ["map 1: robot 0"]
    assert _maps_told(["robot 0", "robot 1", before]) == ["map 1: robot 0", "map 2: robot 1", f"map 3: {before}"]
    assert _maps_told(["robot 0", *[before] * 50]) == ["map 1: robot 0", f"maps 2 to 51: {before}"]
