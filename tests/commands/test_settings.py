"""`twc-env settings` prints a config file that describes every setting."""

import dataclasses
import json
import re

import pytest

from twc_env import TASKS
from twc_env.__main__ import main
from twc_env.config import WORLD_PRESETS, EnvConfig, from_dict, lidar_preset, load, override
from twc_env.config.manual import as_toml
from twc_env.config.robot_presets import ROBOT_PRESETS, TEAM_PRESETS
from twc_env.errors import ConfigError
from twc_env.tasks import task_config

SETTING = re.compile(r"#?\w+ = ")


def uncommented(text: str) -> str:
    return re.sub(r"^#(?=\w)", "", text, flags=re.MULTILINE)


@pytest.mark.parametrize("task", TASKS)
def test_the_printed_settings_can_be_read_back(task, tmp_path):
    (tmp_path / "settings.toml").write_text(as_toml(task_config(task)))
    assert load(tmp_path / "settings.toml") == task_config(task)


def test_every_setting_is_printed_once_with_range_and_description():
    lines = as_toml(EnvConfig()).splitlines()

    def count(section) -> int:
        values = [getattr(section, field.name) for field in dataclasses.fields(section)]
        return sum(count(value) if dataclasses.is_dataclass(value) else 1 for value in values)

    presets = sum(line.startswith("#preset = ") for line in lines)
    assert presets == 2 and sum(bool(SETTING.match(line)) for line in lines) == count(EnvConfig()) + presets
    at = lines.index("#drift = 1.0                          # number from 0 to 10")
    assert lines[at - 1].startswith("# Multiplies every error of the platform's preset")
    assert max(map(len, lines)) <= 200


def test_values_other_than_the_default_are_marked(tmp_path, capsys):
    assert main(["settings", "slam.merging", "--set", "slam.merging.undo=false"]) == 0
    printed = capsys.readouterr().out
    assert "undo = false                          # true or false; default true" in printed
    assert printed.count("; default") == 1
    assert printed.count("\n[") == 1
    (tmp_path / "mine.toml").write_text("[slam.merging]\nundo = false\n")
    assert main(["settings", "slam.merging", "--config", str(tmp_path / "mine.toml")]) == 0
    assert capsys.readouterr().out == printed


def test_the_error_of_an_unknown_section_suggests_the_nearest(capsys):
    with pytest.raises(
        ConfigError, match=r"no section 'slam\.mergin' among the settings; did you mean 'slam\.merging'"
    ):
        as_toml(EnvConfig(), ["slam.mergin"])
    assert main(["settings", "slam.mergin"]) == 2
    assert "did you mean 'slam.merging'?" in capsys.readouterr().err


@pytest.mark.parametrize(("key", "meant"), [("beam_count", "lidar.beam_count"), ("merging.undo", "slam.merging.undo")])
def test_a_setting_without_its_section_is_named_with_it(key, meant):
    with pytest.raises(ConfigError, match=rf"there is no setting \w+; did you mean {meant}\?"):
        override(EnvConfig(), {key: 9})


def test_settings_begin_with_a_task_as_those_of_an_episode_do(capsys):
    assert main(["settings", "--config", "twc/ExploreHard-v0"]) == 0
    assert capsys.readouterr().out == as_toml(task_config("twc/ExploreHard-v0"))
    assert main(["settings", "--config", "twc/ExploreHrd-v0"]) == 2
    assert "did you mean 'twc/ExploreHard-v0'?" in capsys.readouterr().err


def test_a_changed_setting_can_be_read_back(tmp_path):
    config = override(EnvConfig(), {"map": 'odd "name" with \\ in it', "radio.preset": "lte"})
    (tmp_path / "settings.toml").write_text(as_toml(config))
    assert load(tmp_path / "settings.toml") == config


def test_presets_are_explained_in_comments_that_are_no_settings(tmp_path, capsys):
    assert main(["settings", "world", "team", "robot", "lidar"]) == 0
    text = capsys.readouterr().out
    for name, preset in (WORLD_PRESETS | ROBOT_PRESETS).items():
        assert f"# {name}" in text
        for key, value in preset.items():
            assert f"#         {key} = {json.dumps(value)}" in text or f"#     {key} = {json.dumps(value)}" in text
    assert all(f"# {name}: {', '.join(robots)}" in text for name, robots in TEAM_PRESETS.items())
    (tmp_path / "a.toml").write_text(text)
    assert load(tmp_path / "a.toml") == EnvConfig()


def test_a_settings_file_says_which_world_it_is_of(capsys):
    assert main(["settings", "--set", "world=ward", "--set", "people.count=3"]) == 0
    assert "Most settings here are of 'ward'" in capsys.readouterr().out


def test_settings_that_have_their_default_are_commented_out_and_may_all_be_taken_in(tmp_path):
    text = as_toml(EnvConfig())
    assert not any(re.match(r"\w+ = ", line) for line in text.splitlines())
    (tmp_path / "mine.toml").write_text(uncommented(text))
    assert load(tmp_path / "mine.toml") == EnvConfig()


@pytest.mark.parametrize(
    ("before", "after", "settings"),
    [
        ("# All", 'world = "office"\n# All', {"world": "office"}),
        ("[lidar]", '[lidar]\npreset = "lds-01"', {"lidar.preset": "lds-01"}),
        ("[radio]", '[radio]\npreset = "radio-mall"', {"radio.preset": "radio-mall"}),
    ],
)
def test_a_preset_in_a_printed_file_takes_effect_and_one_that_cannot_is_refused(before, after, settings, tmp_path):
    path, text = tmp_path / "mine.toml", as_toml(EnvConfig())
    path.write_text(text.replace(before, after, 1))
    assert load(path) == override(EnvConfig(), settings) != EnvConfig()
    full = uncommented(re.sub("^#preset.*", "", text, flags=re.MULTILINE))
    path.write_text(full.replace(before, after, 1))
    with pytest.raises(ConfigError, match=rf"mine\.toml: {next(iter(settings))} = .* changes nothing") as told:
        load(path)
    assert "\n" not in str(told.value)


def test_a_preset_beside_the_values_that_it_has_is_no_contradiction():
    lidar = dataclasses.asdict(lidar_preset("lds-01"))
    assert from_dict({"lidar": {"preset": "lds-01", **lidar}}).lidar == lidar_preset("lds-01")


def test_worlds_are_explained_with_the_area_that_their_numbers_are_for(capsys):
    assert main(["settings", "world"]) == 0
    assert "people and of furniture are for about 800 m2" in " ".join(capsys.readouterr().out.replace("#", "").split())


@pytest.mark.parametrize(
    ("key", "told"), [("kidnap_step", "the last robot, and no other,"), ("start_spread_s", "at equal intervals")]
)
def test_a_failure_says_which_robots_it_is_for(key, told, capsys):
    assert main(["settings", "failure"]) == 0
    before, _, _ = capsys.readouterr().out.partition(f"#{key} = ")
    assert told in " ".join(before.replace("#", "").split())[-300:]
