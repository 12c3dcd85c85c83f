import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.world.world import World

STILL = np.zeros((3, 2))


def played(steps=12, seed=0, **failure):
    """True poses (steps + 1, 3, 3) and odometry (steps, 3, 3) of robots that stand still."""
    settings = {"map": "twin-01", "robots": 3, **{f"failure.{key}": value for key, value in failure.items()}}
    world = World(override(EnvConfig(), settings), load_map("twin-01"))
    world.reset(seed)
    world.sense()
    poses, odometry = [world.poses.copy()], []
    for _ in range(steps):
        odometry.append(world.tick(STILL).odometry.copy())
        poses.append(world.poses.copy())
    return np.array(poses), np.array(odometry)


def jumps_m(poses):
    return np.hypot(*np.moveaxis(np.diff(poses[..., :2], axis=0), -1, 0))


def test_the_last_robot_is_put_down_metres_away_and_its_odometry_does_not_see_it():
    poses, odometry = played(kidnap_step=5)
    jumped = jumps_m(poses)
    assert jumped[4, 2] >= 3.0 and np.count_nonzero(jumped > 0.1) == 1
    assert np.abs(odometry).max() < 0.05


def test_a_carried_robot_stands_on_free_floor_clear_of_walls():
    poses, _ = played(kidnap_step=5)
    home = load_map("twin-01").home
    assert home.wall_index.distance_m(poses[-1, 2:, :2], 1.0)[0] >= 0.4 - 1e-9


def test_robots_are_carried_at_the_rate_given_at_the_same_times_for_the_same_seed():
    poses, _ = played(600, kidnaps_per_min=6.0)
    count = np.count_nonzero(jumps_m(poses) > 0.5)
    assert 8 <= count <= 30  # 18 expected
    assert np.array_equal(poses[:100], played(99, kidnaps_per_min=6.0)[0])


def test_nobody_carries_robots_that_are_off():
    assert jumps_m(played(kidnap_step=5, robots=1, robots_step=3)[0]).max() == 0.0
    late = jumps_m(played(100, kidnaps_per_min=60.0, start_spread_s=8.0)[0]) > 0.5
    assert not late[:78, 2].any() and not late[:38, 1].any() and late[:38, 0].any() and late[80:, 2].any()


def test_the_path_of_a_team_is_what_it_drove():
    settings = {"robots": 2, "max_cycles": 100, "failure.kidnaps_per_min": 30.0, "slam.mode": "off"}
    env = ExplorationEnv(config={"map": "twin-01", **settings})
    env.reset(seed=0)
    while env.agents:
        env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
    assert env.result()["path_length_m"] == 0.0 and env.result()["odometry_ate_m"] > 1.0
    env.close()


def test_nobody_is_carried_by_default():
    assert jumps_m(played()[0]).max() == 0.0


def test_nobody_puts_a_robot_down_on_a_person():
    settings = {"map": "twin-01", "robots": 3, "people.count": 40, "people.walking_share": 0.0}
    for seed in range(6):
        world = World(override(EnvConfig(), {**settings, "failure.kidnap_step": 5}), load_map("twin-01"))
        world.reset(seed)
        world.sense()
        for _ in range(5):
            world.tick(STILL)
        assert np.hypot(*(world.people_m - world.poses[2, :2]).T).min() > 0.9
