import numpy as np
import pytest

import twc_env
from twc_env.datasets.frame_log import read_frame_log, write_frame_log
from twc_env.errors import DataError


@pytest.fixture(scope="module")
def recorded(wander):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=60)
    env.reset(seed=4)
    steps = [env.frames]
    while env.agents:
        env.step({a: wander(f.ranges_m, f.step, f.robot) for a, f in zip(env.agents, env.frames, strict=True)})
        steps.append(env.frames)
    return env, steps


def test_a_log_gives_back_every_frame_to_the_bit(recorded, tmp_path):
    env, steps = recorded
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    config, read = read_frame_log(tmp_path / "frames.npz")
    assert config == env.config
    assert [len(frames) for frames in read] == [2] * 61
    for before, after in zip(steps, read, strict=True):
        for a, b in zip(before, after, strict=True):
            assert (a.robot, a.step, a.time_s, a.turn_rate_rad_s) == (b.robot, b.step, b.time_s, b.turn_rate_rad_s)
            assert a.signs == b.signs
            assert np.array_equal(a.odometry, b.odometry) and np.array_equal(a.ranges_m, b.ranges_m)
            assert (a.wifi is None) == (b.wifi is None)
            if a.wifi is not None:
                assert np.array_equal(a.wifi.macs, b.wifi.macs)
                assert np.array_equal(a.wifi.rssi_dbm, b.wifi.rssi_dbm)


def test_ages_of_repeated_readings_survive(tmp_path):
    radio = {"stale_age_max_s": 5.0, "sweep_share": 0.5}
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=10, config={"radio": radio})
    env.reset(seed=1)
    steps = [env.frames]
    while env.agents:
        env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
        steps.append(env.frames)
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    scans = [
        [frames[0].wifi for frames in run if frames[0].wifi]
        for run in (steps, read_frame_log(tmp_path / "frames.npz")[1])
    ]
    assert any(scan.age_s.max(initial=0.0) > 0 for scan in scans[0])
    assert all(np.array_equal(a.age_s, b.age_s) for a, b in zip(*scans, strict=True))


def test_the_engine_finds_on_a_log_what_it_found_in_the_world(recorded, tmp_path):
    env, steps = recorded
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    config, read = read_frame_log(tmp_path / "frames.npz")
    engine = twc_env.CooperativeSlam(config, 2)
    for frames in read:
        engine.update(frames)
    engine.finish()
    for robot, agent in enumerate(env.possible_agents):
        belief = env.belief(agent)
        assert np.array_equal(engine.pose_map_robot(robot), belief.pose_map_robot)
        assert np.array_equal(engine.belief(robot).grid.log_odds, belief.grid.log_odds)


def test_an_empty_log_is_refused(tmp_path):
    with pytest.raises(DataError, match="no frames to write"):
        write_frame_log(tmp_path / "frames.npz", twc_env.EnvConfig(), [])


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "other"])
def test_a_damaged_log_is_refused_in_one_line(recorded, tmp_path, damage):
    env, steps = recorded
    path = tmp_path / "frames.npz"
    write_frame_log(path, env.config, steps)
    if damage == "missing":
        path.unlink()
    elif damage == "text":
        path.write_text("no numbers here")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:2000])
    else:
        np.savez(path, something=np.zeros(3))
    with pytest.raises(DataError) as error:
        read_frame_log(path)
    assert "\n" not in str(error.value) and "frames.npz" in str(error.value)
