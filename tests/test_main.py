import json

import pytest

import twc_env
from twc_env.__main__ import main
from twc_env.datasets.frame_log import write_frame_log


def test_bench_writes_one_flat_object_with_both_speeds(tmp_path, capsys):
    path = tmp_path / "bench.json"
    assert main(["bench", "--steps", "40", "--episodes", "1", "--robots", "2", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert figures["world_env_steps_per_s"] > figures["slam_env_steps_per_s"] > 0
    assert figures["robots"] == 2 and figures["beams"] == 180 and figures["steps"] == 40
    assert not any(isinstance(value, (dict, list)) for value in figures.values())
    assert "slam_env_steps_per_s" in capsys.readouterr().out


def test_bench_takes_any_setting(tmp_path):
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
        (["replay", "nowhere.npz"], "cannot read the frame log nowhere.npz"),
    ],
)
def test_bad_input_ends_with_one_line_and_status_2(arguments, message, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and error.count("\n") == 1


@pytest.mark.parametrize("kind", ["compiled", "filterpy"])
def test_replay_finds_the_same_poses_as_the_episode(kind, tmp_path, wander, capsys):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=50)
    env.reset(seed=1)
    steps = [env.frames]
    while env.agents:
        env.step({a: wander(f.ranges_m, f.step, f.robot) for a, f in zip(env.agents, env.frames, strict=True)})
        steps.append(env.frames)
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    arguments = ["replay", str(tmp_path / "frames.npz"), "--filter", kind, "--out", str(tmp_path / "out")]
    assert main([*arguments, "--json", str(tmp_path / "replay.json")]) == 0
    poses = json.loads((tmp_path / "replay.json").read_text())["final_poses"]
    for pose, agent in zip(poses, env.possible_agents, strict=True):
        assert pose == pytest.approx(env.belief(agent).pose_map_robot, abs=1e-5)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"map.pgm", "map.yaml", "pose_graph.g2o"} <= written


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert all(command in out for command in ("maps", "bench", "replay"))
