import json
import tomllib

import pytest

from twc_env.config import (
    LIDAR_PRESETS,
    ROBOT_PRESETS,
    ROBOT_SETTINGS,
    TEAM_PRESETS,
    EnvConfig,
    digest,
    from_dict,
    has_one_scanner,
    override,
    robot_configs,
    shared_config,
    to_dict,
)
from twc_env.config.manual import as_toml
from twc_env.errors import ConfigError
from twc_env.exploration.settings import resolve

MIXED = {"robot": ["turtlebot-burger", {"preset": "handheld", "lidar": {"preset": "utm-30lx"}}, {"odometry.drift": 2}]}


def test_each_robot_has_its_own_settings_and_those_of_the_team_for_the_rest():
    burger, handheld, plain = robot_configs(override(EnvConfig(), MIXED | {"lidar.beam_count": 90}))
    assert (burger.dynamics.speed_max_m_s, burger.lidar.range_max_m, burger.lidar.mount_x_m) == (0.22, 3.5, -0.032)
    assert (handheld.odometry.platform, handheld.lidar.beam_count) == ("handheld", 1081)
    assert (plain.odometry.drift, plain.lidar.beam_count, plain.dynamics) == (2.0, 90, EnvConfig().dynamics)


def test_the_short_forms_are_the_long_one():
    wanted = override(EnvConfig(), {"robot": ["handheld", "wheeled", "legged"]})
    assert override(EnvConfig(), {"team": "handheld, wheeled,legged"}) == wanted
    assert override(EnvConfig(), {"robot": "handheld,wheeled,legged"}) == wanted
    assert override(EnvConfig(), {"robot": '["handheld", {"preset": "wheeled"}, "legged"]'}) == wanted
    assert from_dict({"team": ["handheld", "wheeled", "legged"]}) == wanted
    assert from_dict(tomllib.loads('robot = ["handheld"]\n')).robots == 1
    assert (
        resolve({"team": "twc-slam"}, None, {"robots": 3}).robot == EnvConfig(robot=[*TEAM_PRESETS["twc-slam"]]).robot
    )


@pytest.mark.parametrize("team", [*TEAM_PRESETS, *ROBOT_PRESETS])
def test_every_preset_is_valid_and_survives_files(team):
    config = override(EnvConfig(), {"team": team})
    assert from_dict(json.loads(json.dumps(to_dict(config)))) == config
    assert from_dict(tomllib.loads(as_toml(config))) == config
    assert digest(config) != digest(EnvConfig()) == "17a40728f799"


def test_a_list_says_how_many_robots_there_are_unless_their_number_contradicts_it():
    assert override(EnvConfig(), {"robot": ["legged"] * 5}).robots == 5
    assert override(EnvConfig(), MIXED | {"robot": []}) == EnvConfig()
    with pytest.raises(ConfigError, match="robot lists 3 robots, and robots is 4: give one entry for each robot"):
        override(override(EnvConfig(), MIXED), {"robots": 4})
    two = override(override(EnvConfig(), MIXED), {"robots": 2})
    assert two.robot == override(EnvConfig(), MIXED).robot[:2], "fewer are the first ones"


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("legged, wheled", r"robot\[1\]\.preset must be one of .*; got 'wheled'; did you mean 'wheeled'\?"),
        ([{"dynamics.time_step_s": 0.1}], r"robot\[0\]\.dynamics\.time_step_s cannot differ between robots.*speed_max"),
        (
            [{"map": "twin-02"}],
            r"robot\[0\]\.map cannot differ between robots: set it for the team; possible are preset, lidar\.preset",
        ),
        ([{"drift": 1.0}], r"robot\[0\]\.drift cannot differ between robots; did you mean odometry\.drift\?"),
        ([{"lidar.preset": "utm"}], r"robot\[0\]\.lidar\.preset must be one of ideal, .*; got 'utm'"),
        ([{"odometry.drift": "far"}], r"robot\[0\]\.odometry\.drift must be a number; got 'far'"),
        ([{"odometry.drift": 99}], r"robot\[0\]: odometry\.drift must lie in \[0, 10\]; got 99"),
        ([{"lidar.is_rolling": True}], r"robot\[0\]: lidar\.is_rolling is true and lidar\.rate_hz 0"),
        ([3], r"robot\[0\] must be the name of a preset or a table of settings; got 3"),
        (3, "robot must be a list with a preset or a table of settings for each robot; got 3"),
        ("[1,", r"robot is no list in JSON: .*; got '\[1,'"),
    ],
)
def test_an_invalid_robot_is_refused_in_one_line_that_names_it(robot, message):
    with pytest.raises(ConfigError, match=message) as told:
        override(EnvConfig(), {"robot": robot})
    assert "\n" not in str(told.value)


SCANNERS = ("lds-01", "mid-360", "utm-30lx")


def test_every_setting_of_a_robot_is_a_setting_of_the_team():
    missing = []
    for key in ROBOT_SETTINGS:
        node = to_dict(EnvConfig())
        for part in key.split("."):
            node = node.get(part, {}) if isinstance(node, dict) and part in node else missing.append(key)
    assert ROBOT_SETTINGS and missing == []


def test_a_team_shares_circles_of_the_best_scanner_and_keeps_sizes_and_assumptions():
    config = override(EnvConfig(), MIXED)
    shared = shared_config(config)
    assert not has_one_scanner(config)
    assert (shared.lidar.beam_count, shared.lidar.range_max_m, shared.lidar.scanner) == (360, 30.0, None)
    assert [own.dynamics.robot_radius_m for own in robot_configs(shared)] == [0.113, 0.25, 0.2]
    told, assumed = robot_configs(shared), robot_configs(config)
    assert [own.slam.odometry_filter for own in told] == [own.slam.odometry_filter for own in assumed]
    assert shared_config(shared) == shared
    assert shared_config(EnvConfig()) is EnvConfig() or shared_config(EnvConfig()) == EnvConfig()


def test_the_shared_scanner_of_a_team_is_as_noisy_as_the_noisiest_at_any_range():
    config = override(EnvConfig(), {"robots": 3, "robot": [{"lidar.preset": name} for name in SCANNERS]})
    shared = shared_config(config).lidar
    assert (shared.range_noise_std_m, shared.range_noise_per_m) == (0.02, 0.0175)


def test_nothing_of_the_true_errors_reaches_the_shared_settings():
    drifting = override(EnvConfig(), {"robot": [{"odometry.drift": 3.0}, {"radio.device_offset_db": 9.0}, {}]})
    shared = shared_config(drifting)
    assert (shared.odometry, shared.radio, shared.robot) == (EnvConfig().odometry, EnvConfig().radio, ())


def test_perfect_poses_need_perfect_odometry_of_every_robot():
    config = resolve({"slam.oracle": "poses", "robot": [{"odometry.drift": 3.0}, {}]}, None, {})
    assert [own.odometry.drift for own in robot_configs(config)] == [0.0, 0.0]


def test_scanner_presets_of_robots_leave_nothing_of_the_team_s_scanner():
    config = override(EnvConfig(), {"lidar.dropout_probability": 0.3, "robot": [{"lidar.preset": "lds-01"}, {}]})
    own = [each.lidar.dropout_probability for each in robot_configs(config)]
    assert own == [0.0, 0.3] and "lds-01" in LIDAR_PRESETS
