import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import twc_env
from twc_env import metrics
from twc_env.__main__ import main
from twc_env.__main__ import main as agents
from twc_env.bench.rates import wander as drive
from twc_env.config import override
from twc_env.datasets.logs.frame_log import read_frame_log, read_truth_log, write_frame_log, write_truth_log
from twc_env.datasets.logs.tum import read_tum
from twc_env.maps import bundled_folder
from twc_env.records.geometry import compose


def test_bench_writes_one_flat_object_with_both_speeds(tmp_path, capsys):
    path = tmp_path / "bench.json"
    assert main(["bench", "--steps", "40", "--episodes", "1", "--robots", "2", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert figures["world_env_steps_per_s"] > figures["slam_env_steps_per_s"] > 0
    assert figures["robots"] == 2 and figures["beams"] == 180 and figures["steps"] == 40
    assert not any(isinstance(value, (dict, list)) for value in figures.values())
    assert "slam_env_steps_per_s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("setting", "robots", "beams"), [("team=handheld,wheeled", 2, 180), ("lidar.preset=lms-200", 3, 181)]
)
def test_bench_plays_the_team_and_the_scanner_of_its_settings(setting, robots, beams, tmp_path):
    path = tmp_path / "bench.json"
    assert main(["bench", "--steps", "5", "--episodes", "1", "--set", setting, "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert (figures["robots"], figures["beams"]) == (robots, beams)


def test_record_plays_the_task_and_the_team_of_its_settings(tmp_path):
    call = ["record", "--config", "twc/ExploreMixed-v1", "--map", "twin-01", "--steps", "2", "--out", str(tmp_path)]
    assert main(call) == 0
    config, _ = read_frame_log(tmp_path / "frames.npz")
    assert len(config.robot) == config.robots == 3 and config.people.count == 12


def test_bench_measures_one_thing_at_a_time(capsys):
    with pytest.raises(SystemExit):
        main(["bench", "--parts", "--peers"])
    assert "--peers: not allowed with argument --parts" in capsys.readouterr().err


def test_bench_accepts_any_setting(tmp_path):
    path = tmp_path / "bench.json"
    arguments = ["bench", "--steps", "5", "--episodes", "1", "--robots", "1", "--set", "lidar.beam_count=90"]
    assert main([*arguments, "--json", str(path)]) == 0
    assert json.loads(path.read_text())["beams"] == 90


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bench", "--map", "twin-1"], "did you mean 'twin-01'"),
        (["bench", "--set", "lidar.beam_cont=9"], "did you mean 'beam_count'"),
        (["bench", "--set", "lidar"], "KEY=VALUE"),
        (["bench", "--workers", "2"], "--workers 2: it needs --training TASK; leave it out"),
        (["bench", "--workers", "0", "--memory"], "--workers 0: it needs --training TASK"),
        (["bench", "--ray", "auto", "--teams", "ExploreQuick-v1"], "--ray auto: it needs --training TASK"),
        (["bench", "--training", "ExploreQuick-v1", "--map", "twin-01"], "--map twin-01: --training plays its task"),
        (["bench", "--training", "ExploreQuick-v1", "--steps", "1500"], "--steps 1500: --training plays its task"),
        (["bench", "--teams", "ExploreQuick-v1", "--robots", "2"], "--robots 2: --teams plays its task"),
        (["bench", "--memory", "--beams", "90"], "--beams 90: --memory measures the tasks of the suite v1 as they are"),
        (["bench", "--memory", "--set", "robots=2"], "--set robots=2: --memory measures the tasks"),
        (["bench", "--peers", "--map", "twin-01"], "--map twin-01: --peers has fixed settings"),
        (["bench", "--scaling", "--episodes", "3"], "--episodes 3: --scaling has fixed settings"),
        (["bench", "--vector", "--episodes", "3"], "--episodes 3: --vector plays one episode of --steps in each"),
        (["bench", "--long", "--episodes", "3"], "--episodes 3: --long plays one episode"),
        (["bench", "--beams", "90", "--set", "lidar.beam_count=80"], "--beams 90 and --set lidar.beam_count=80 name"),
        (["replay", "nowhere.npz"], "there is no run folder or log nowhere.npz"),
        (["explore", "--robots", "2", "--set", "team=turtlebots"], "--robots 2 and --set team=turtlebots name the"),
        (["explore", "--map", "twin-01", "--set", "map=twin-02"], "--map twin-01 and --set map=twin-02 name the same"),
        (["watch", "--steps", "9", "--set", "max_cycles=3"], "--steps 9 and --set max_cycles=3 name the same setting"),
        (["compare", "--set", "map=twin-01"], "--set map=twin-01: compare plays the buildings named by --maps"),
        (["compare", "--buildings", "101"], "the split test has 100 buildings; got --buildings 101"),
        (["compare", "--maps", "twin-01", "--set", "map=gen:office:100:test"], "named by --maps; use that"),
    ],
)
def test_bad_input_ends_with_one_line_and_status_2(arguments, message, refusal):
    assert message in refusal(main, arguments)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError("Could not find/load shared object file 'libllvmlite.so' from resource location"),
        ImportError("libopenblas.so: failed to map segment from shared object"),
        OSError(12, "Cannot allocate memory"),
    ],
)
def test_too_little_memory_is_told_in_one_line(error, monkeypatch, capsys):
    def without_memory(*_):
        raise error

    monkeypatch.setattr("twc_env.__main__.run_command", without_memory)
    assert main(["maps", "list"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: there is too little memory") and told.count("\n") == 1
    monkeypatch.setattr("twc_env.__main__.run_command", lambda *_: (_ for _ in ()).throw(OSError(5, "broken disk")))
    with pytest.raises(OSError, match="broken disk"):
        main(["maps", "list"])


def test_a_folder_without_a_run_is_named(tmp_path, refusal):
    assert f"{tmp_path} is no run folder (no frames.npz): name a log" in refusal(main, ["replay", str(tmp_path)])


@pytest.mark.parametrize("arguments", ["bench --episodes 0", "bench --robots x", "record --out r --steps 0"])
def test_counts_below_one_are_rejected_by_the_command_line(arguments, capsys):
    with pytest.raises(SystemExit):
        main(arguments.split())
    assert "must be a whole number of at least 1; got" in capsys.readouterr().err


def _write_episode(path, env, wander):
    """Play an episode and write its frames."""
    env.reset(seed=1)
    steps = [env.frames]
    while env.agents:
        env.step({a: wander(f.ranges_m, f.step, f.robot) for a, f in zip(env.agents, env.frames, strict=True)})
        steps.append(env.frames)
    write_frame_log(path, env.config, steps)


@pytest.mark.parametrize("kind", ["compiled", "filterpy"])
def test_replay_finds_the_same_poses_as_the_episode(kind, tmp_path, wander, capsys):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=50)
    _write_episode(tmp_path / "frames.npz", env, wander)
    chosen = ["--set", f"slam.odometry_filter.backend={kind}"]
    arguments = ["replay", str(tmp_path / "frames.npz"), *chosen, "--out", str(tmp_path / "out")]
    assert main([*arguments, "--json", str(tmp_path / "replay.json")]) == 0
    poses = json.loads((tmp_path / "replay.json").read_text())["final_poses"]
    for pose, agent in zip(poses, env.possible_agents, strict=True):
        assert pose == pytest.approx(env.belief(agent).pose_map_robot, abs=1e-5)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"map.pgm", "map.yaml", "pose_graph.g2o"} <= written


def test_a_replay_of_an_episode_without_slam_integrates_its_odometry(tmp_path, wander):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=60, config={"slam.mode": "off"})
    _write_episode(tmp_path / "frames.npz", env, wander)
    write_truth_log(tmp_path / "truth.npz", 1, "twin-01", env.result().true_poses)
    arguments = ["replay", str(tmp_path / "frames.npz"), "--truth", str(tmp_path / "truth.npz")]
    assert main([*arguments, "--json", str(tmp_path / "replay.json")]) == 0
    found = json.loads((tmp_path / "replay.json").read_text())
    assert found["final_poses"] == np.round([env.belief(a).pose_map_robot for a in env.possible_agents], 6).tolist()
    assert found["keyframes"] == [0, 0] and found["team_ate_m"] == env.result().figures["team_ate_m"]


def test_a_replay_does_not_depend_on_the_frame_numbers_of_robots(tmp_path):
    """The frame numbers of one robot are far ahead, and its frames end early."""
    assert main(["record", "--map", "twin-01", "--seed", "1", "--steps", "800", "--out", str(tmp_path)]) == 0
    config, steps = read_frame_log(tmp_path / "frames.npz")
    config = override(config, {"max_cycles": 100_000})  # not the last step: the mapper's backlog is not processed
    kept = [[frame for frame in frames if frame.robot or frame.step < 300] for frames in steps]
    numbered = [[replace(frame, step=frame.step + 10_000 * (frame.robot == 0)) for frame in frames] for frames in kept]
    found = []
    for each in (kept, numbered):
        write_frame_log(tmp_path / "other.npz", config, each)
        assert main(["replay", str(tmp_path / "other.npz"), "--json", str(tmp_path / "replay.json")]) == 0
        found.append(json.loads((tmp_path / "replay.json").read_text()))
    assert found[0] == found[1]


def test_a_frame_log_is_recognised_by_its_content(tmp_path, capsys):
    assert main(["record", "--steps", "5", "--out", str(tmp_path)]) == 0
    (tmp_path / "frames.npz").rename(tmp_path / "monday.frames")
    assert main(["replay", str(tmp_path / "monday.frames")]) == 0
    assert "settings digest" in capsys.readouterr().out


def test_a_recording_replays_to_the_same_estimates_and_is_scored_against_its_own_truth(tmp_path, capsys):
    out = tmp_path / "log"
    assert main(["record", "--steps", "60", "--robots", "2", "--seed", "3", "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {"frames.npz", "truth.npz"}
    found = []
    for k in range(2):
        arguments = ["replay", str(out / "frames.npz"), "--truth", str(out / "truth.npz")]
        assert main([*arguments, "--json", str(tmp_path / f"{k}.json")]) == 0
        found.append((tmp_path / f"{k}.json").read_text())
    assert found[0] == found[1]
    assert 0.0 < json.loads(found[0])["team_ate_m"] < 0.1


def test_the_frame_log_contains_no_true_pose(tmp_path):
    out = tmp_path / "log"
    assert main(["record", "--steps", "20", "--robots", "1", "--out", str(out)]) == 0
    _, _, true_poses = read_truth_log(out / "truth.npz")
    with np.load(out / "frames.npz") as log:
        assert "true_poses" not in log.files
        for name in log.files:
            if log[name].dtype.kind == "f" and log[name].ndim == 2 and len(log[name]) == 21:
                assert not np.isclose(log[name][5:], true_poses[5:, 0, :1]).all(axis=0).any()


def test_a_replay_reports_that_the_oracle_is_ignored(tmp_path, capsys):
    record = ["record", "--robots", "2", "--steps", "3", "--out", str(tmp_path)]
    for oracle, said in (("starts", "slam.oracle = 'starts'"), ("none", "")):
        assert main([*record, "--set", f"slam.oracle={oracle}"]) == 0
        capsys.readouterr()
        assert main(["replay", str(tmp_path)]) == 0
        remark = capsys.readouterr().err
        assert said in remark and bool(remark) == bool(said)


@pytest.mark.parametrize("is_enabled", [True, False])
def test_a_replay_reports_that_known_transmitters_are_ignored(is_enabled, tmp_path, capsys):
    radio = "slam.k_visibility"
    settings = ["--set", f"{radio}.enabled={is_enabled}", "--set", f"{radio}.are_transmitters_known=true"]
    assert main(["record", "--robots", "2", "--steps", "3", *settings, "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["replay", str(tmp_path)]) == 0
    assert (f"{radio}.are_transmitters_known: ignored" in capsys.readouterr().err) is is_enabled


@pytest.mark.parametrize("kind", ["waypoint", "frontier"])
def test_a_recorded_team_is_driven_by_velocities_only(kind, tmp_path, refusal):
    arguments = ["record", "--steps", "30", "--out", str(tmp_path / "out"), "--set", f"action.kind={kind}"]
    assert "action.kind must be 'velocity'" in refusal(main, arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_a_replay_of_peers_reports_whose_groups_it_prints(topology, tmp_path, capsys):
    main(["record", "--set", f"link.topology={topology}", "--steps", "3", "--out", str(tmp_path)])
    capsys.readouterr()
    main(["replay", str(tmp_path / "frames.npz")])
    assert ("are those of robot 0" in capsys.readouterr().err) is (topology == "peer")


def test_maps_of_a_replay_are_named_like_those_of_the_episode_largest_group_first(tmp_path):
    run, again = tmp_path / "run", tmp_path / "again"
    assert agents(["explore", "--steps", "200", "--no-pictures", "--out", str(run)]) == 0
    assert main(["replay", str(run), "--out", str(again), "--no-pictures"]) == 0
    names = {"map.pgm", "map.yaml", "map_2.pgm", "map_2.yaml"}  # two robots have met
    assert {path.name for path in run.glob("map*")} == {path.name for path in again.glob("map*")} == names
    assert all((run / name).read_bytes() == (again / name).read_bytes() for name in names)


def test_a_robot_that_was_never_received_has_neither_map_nor_path(tmp_path):
    never = ["--set", "failure.robots=1", "--set", "failure.robots_step=0"]
    assert main(["record", "--robots", "2", "--steps", "3", *never, "--out", str(tmp_path)]) == 0
    assert main(["replay", str(tmp_path), "--out", str(tmp_path / "maps")]) == 0
    paths = {f"robot_0_{kind}.tum" for kind in ("estimated", "odometry")}
    written = {path.name for path in (tmp_path / "maps").rglob("*.*")}
    pictures = {"map.png", "replay.html"}
    assert written == {"map.pgm", "map.yaml", "pose_graph.g2o", "pose_graph.csv", "table.csv"} | pictures | paths


def test_truth_of_another_run_is_rejected(tmp_path, capsys):
    for name, steps in (("a", "10"), ("b", "12")):
        assert main(["record", "--steps", steps, "--robots", "1", "--out", str(tmp_path / name)]) == 0
    assert main(["replay", str(tmp_path / "a/frames.npz"), "--truth", str(tmp_path / "b/truth.npz")]) == 2
    assert "give the pair of one run" in capsys.readouterr().err


def test_replay_errors_of_another_scanner_or_an_unwritable_folder_are_one_line(tmp_path, refusal):
    assert main(["record", "--robots", "1", "--steps", "3", "--out", str(tmp_path / "log")]) == 0
    (tmp_path / "file").write_text("")
    for extra, message in (
        (["--set", "lidar.beam_count=90"], "lidar.beam_count is 90"),
        (["--out", str(tmp_path / "file" / "x")], "cannot write to the folder"),
        (["--json", str(tmp_path / "file" / "x.json")], "cannot write"),
    ):
        assert message in refusal(main, ["replay", str(tmp_path / "log"), *extra])


def test_ctrl_c_ends_a_command_with_one_line(monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("twc_env.maps.load_map", interrupt)
    assert main(["maps", "list"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_reader_that_closes_the_output_early_is_no_error():
    command = f"{sys.executable} -m twc_env maps list | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert done.stdout.startswith("map ") and done.stderr == ""


@pytest.mark.parametrize("closed", ["1>&-", "2>&-", "1>&- 2>&-"])
def test_a_command_with_closed_output_still_does_its_work(tmp_path, closed):
    arguments = f"explore --robots 1 --steps 2 --no-pictures --out {tmp_path / 'run'} {closed}"
    done = subprocess.run(f"{sys.executable} -m twc_env {arguments}", shell=True, capture_output=True, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert (tmp_path / "run" / "report.json").exists()


@pytest.mark.parametrize("buffering", ["", "1"], ids=["buffered", "unbuffered"])
def test_every_command_ends_silently_when_its_reader_closes_the_output(buffering):
    program = "import sys; from twc_env.running.command_line import exit_status; "
    program += "sys.exit(exit_status(lambda: print(chr(10).join(map(str, range(int(sys.argv[1]))))) or 0))"
    for lines in ("9", "99999"):
        command = [sys.executable, "-c", program, lines]
        reader, writer = os.pipe()
        os.close(reader)
        done = subprocess.run(
            command, stdout=writer, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": buffering}
        )
        os.close(writer)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk is filled by a device of Linux")
def test_a_full_disk_is_an_error_of_one_line_for_every_output(tmp_path):
    (tmp_path / "truth.npz").symlink_to("/dev/full")
    record = ["record", "--steps", "3", "--robots", "1", "--out", str(tmp_path)]
    for arguments, place in ((["maps", "list"], "/dev/full"), (record, os.devnull)):
        with open(place, "w") as out:
            command = [sys.executable, "-m", "twc_env", *arguments]
            done = subprocess.run(command, stdout=out, stderr=subprocess.PIPE, text=True)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        *_, last = done.stderr.splitlines()
        assert last == "error: cannot write: No space left on device; make room, or choose another place"


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
@pytest.mark.parametrize("buffering", ["", "1"])
def test_output_that_a_disk_takes_in_part_only_is_an_error(tmp_path, buffering):
    import resource

    command = [sys.executable, "-m", "twc_env", "settings"]
    with (tmp_path / "out").open("w") as out:
        done = subprocess.run(
            command, stdout=out, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": buffering},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
        )  # fmt: skip
    assert (tmp_path / "out").stat().st_size == 4096
    assert done.returncode == 2 and done.stderr.startswith("error: cannot write: ")


def test_characters_that_the_terminal_cannot_show_are_escaped(tmp_path):
    plan = json.loads((bundled_folder() / "twin-01.json").read_text())
    (tmp_path / "plan.json").write_text(json.dumps({**plan, "name": "Büro 階"}))
    command = [sys.executable, "-m", "twc_env", "maps", "list", str(tmp_path / "plan.json")]
    for encoding, shown in (("ascii", r"B\xfcro \u968e"), ("cp1252", r"Büro \u968e"), ("utf-8", "Büro 階")):
        done = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding})
        assert (done.returncode, done.stderr) == (0, b"")
        assert shown.encode(encoding) in done.stdout


def test_an_interrupted_table_reports_that_it_can_continue(monkeypatch, tmp_path, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("twc_env.reproduce.twc.matching.rows", interrupt)
    assert main(["reproduce", "matching", "--cache", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "finished parts are kept: the same command continues from there\ninterrupted\n"


def write_laser_log(path, seed, place="twin-01"):
    """Drive one robot through a building and write the front half of its scans as a CARMEN log; returns times [s] and
    true poses."""
    settings = {"lidar.beam_count": 360, "lidar.range_max_m": 20.0, "odometry.platform": "skid-steer", "robots": 1}
    env = twc_env.parallel_env(map=place, max_cycles=800, config={**settings, "slam.mode": "off"})
    env.reset(seed=seed)
    lines, stamps_s, true, odometry = [], [], [], np.zeros(3)
    for actions in drive(env, seed):
        env.step(actions)
        frame = env.frames[0]
        odometry = compose(odometry, frame.odometry)
        if frame.step % 5 == 0:
            half_circle = np.roll(frame.ranges_m, 90)[:180]
            stamps_s.append(seed * 1e9 + frame.time_s)
            numbers = [*half_circle, *odometry, *odometry, stamps_s[-1]]
            lines.append(f"FLASER 180 {' '.join(map(str, numbers))} robot 0.0")
            true.append(env.state()[:3])
    path.write_text("\n".join(lines))
    return stamps_s, np.array(true)


def test_a_carmen_log_is_mapped_and_exported_to_standard_formats(tmp_path, capsys):
    stamps_s, true = write_laser_log(tmp_path / "mine.log", 1)
    assert main(["replay", str(tmp_path / "mine.log"), "--out", str(tmp_path / "out")]) == 0
    assert "map 1: robot 0" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "out").rglob("*.*")}
    assert {"map.pgm", "map.yaml", "pose_graph.g2o", "robot_0_estimated.tum", "robot_0_odometry.tum"} <= written
    (tmp_path / "other.log").write_text("ODOM 0 0 0")
    assert main(["replay", str(tmp_path / "other.log")]) == 2
    assert "is not a CARMEN log" in capsys.readouterr().err
    off_m = {}
    for kind in ("estimated", "odometry"):
        times_s, poses = read_tum(tmp_path / "out" / "trajectories" / f"robot_0_{kind}.tum")
        assert times_s == pytest.approx(stamps_s, rel=0, abs=1e-3)
        off_m[kind] = metrics.absolute_trajectory_error_m(poses[:, :2], true[:, :2])
    assert off_m["estimated"] < 0.1 < 3 * 0.1 < off_m["odometry"]


def test_laser_logs_of_two_robots_become_one_map(tmp_path, capsys):
    names = [str(tmp_path / "monday.log"), str(tmp_path / "tuesday.log")]
    driven = [write_laser_log(tmp_path / name, seed, "sfw-e2") for seed, name in enumerate(names, 1)]
    assert main(["replay", *names, "--out", str(tmp_path / "out"), "--json", str(tmp_path / "out.json")]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["groups"] == [[0, 1]]
    paths = [read_tum(tmp_path / "out" / "trajectories" / f"robot_{r}_estimated.tum") for r in (0, 1)]
    for (times_s, _), (stamps_s, _) in zip(paths, driven, strict=True):
        assert times_s == pytest.approx(stamps_s, rel=0, abs=1e-3)
    estimated, true = (np.concatenate([p[:, :2] for _, p in pairs]) for pairs in (paths, driven))
    assert metrics.absolute_trajectory_error_m(estimated, true) < 0.1  # one alignment for both
    assert main(["record", "--steps", "5", "--out", str(tmp_path / "run")]) == 0
    assert main(["replay", names[0], str(tmp_path / "run")]) == 2
    assert "is of a whole team: give it alone" in capsys.readouterr().err
