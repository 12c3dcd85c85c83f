import copy
import dataclasses
import json
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.config import (
    WORLD_PRESETS,
    EnvConfig,
    LidarConfig,
    digest,
    from_dict,
    lidar_preset,
    load,
    override,
    radio_preset,
    to_dict,
    world_of,
    world_preset,
)
from twc_env.errors import ConfigError, did_you_mean, one_of


def numeric_fields():
    """(dotted key, minimum, maximum, is_integer) of every numeric setting."""

    def walk(cls, prefix):
        for field in dataclasses.fields(cls):
            default = field.default_factory() if callable(field.default_factory) else field.default
            if dataclasses.is_dataclass(default):
                yield from walk(type(default), f"{prefix}{field.name}.")
            elif "minimum" in field.metadata:
                yield (
                    f"{prefix}{field.name}",
                    field.metadata["minimum"],
                    field.metadata["maximum"],
                    isinstance(default, int),
                )

    return list(walk(EnvConfig, ""))


def test_values_survive_a_round_trip_through_json():
    config = override(EnvConfig(), {"lidar.beam_count": 90, "slam.merging.closures_min": 4, "map": "twin-02"})
    assert from_dict(json.loads(json.dumps(to_dict(config)))) == config


def test_missing_values_keep_their_default():
    config = from_dict({"lidar": {"beam_count": 90}})
    assert config.lidar.beam_count == 90
    assert config.lidar.range_max_m == LidarConfig().range_max_m
    assert config.radio == EnvConfig().radio


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lidr": {}}, r"there is no setting lidr; did you mean 'lidar'\?"),
        ({"worl": "ward"}, r"there is no setting worl; did you mean 'world'\?"),
        ({"teams": "turtlebots"}, r"there is no setting teams; did you mean 'team'\?"),
        ({"task": "twc/ExploreQuick-v1"}, r"there is no setting task: twc_env\.task_config\(ID\) gives the settings"),
        ({"lidar": {"beam_cuont": 9}}, r"there is no setting lidar\.beam_cuont; did you mean 'beam_count'\?"),
        ({"slam": {"merging": {"wifi": True}}}, r"there is no setting slam\.merging\.wifi"),
        ({"lidar": {"beam_count": 90.5}}, r"beam_count must be a whole number; got 90\.5"),
        ({"lidar": {"beam_count": True}}, r"beam_count must be a whole number; got True"),
        ({"lidar": {"beam_count": "90"}}, r"beam_count must be a whole number; got '90'"),
        ({"lidar": {"range_max_m": None}}, r"range_max_m must be a number; got None"),
        ({"lidar": {"beam_count": 2}}, r"lidar\.beam_count must lie in \[8, 4096\]; got 2"),
        ({"lidar": {"range_max_m": math.nan}}, r"lidar\.range_max_m must lie in \[0\.5, 100\]; got nan"),
        ({"lidar": {"range_max_m": math.inf}}, r"lidar\.range_max_m must lie in \[0\.5, 100\]; got inf"),
        ({"lidar": 3}, r"lidar must be a table of settings; got 3"),
        ({"odometry": {"platform": "weeled"}}, r"platform must be one of .*; got 'weeled'; did you mean 'wheeled'\?"),
        ({"map": 3}, r"map must be text; got 3"),
        ({"robots": 0}, r"^robots must lie in \[1, 64\]; got 0"),
        ({"slam": {"local_map": {"resolution_m": 0.0}}}, r"^slam\.local_map\.resolution_m must lie in .*; got 0"),
        ({"slam": {"merging": {"wifi_check": 1}}}, r"wifi_check must be true or false; got 1"),
    ],
)
def test_an_invalid_setting_is_rejected_in_one_line_with_its_name(values, message):
    with pytest.raises(ConfigError, match=message) as caught:
        from_dict(values)
    assert "\n" not in str(caught.value)


BESIDE = {"failure.robots": {"robots": 64}, "failure.link_begin_step": {"failure.link_end_step": 10_000_000}}
"""What else must be set so that a setting can have its greatest value."""


@pytest.mark.parametrize(("key", "minimum", "maximum", "is_integer"), numeric_fields(), ids=lambda value: str(value))
def test_each_number_accepts_its_limits_and_rejects_values_beyond(key, minimum, maximum, is_integer):
    step, config = 1 if is_integer else 1e-3, override(EnvConfig(), BESIDE.get(key, {}))
    for limit, beyond in ((minimum, minimum - step), (maximum, maximum + max(step, abs(maximum) * 1e-9))):
        override(config, {key: int(limit) if is_integer else float(limit)})
        with pytest.raises(ConfigError, match=key.split(".")[-1]):
            override(config, {key: int(beyond) if is_integer else float(beyond)})


def test_a_direct_constructor_checks_its_range_too():
    with pytest.raises(ConfigError, match=r"lidar\.beam_count must lie in"):
        LidarConfig(beam_count=0)


def test_a_direct_constructor_rejects_a_dict_as_section():
    with pytest.raises(ConfigError, match=r"lidar must be a LidarConfig; got .*from_dict"):
        EnvConfig(lidar={"beam_count": 90})


def test_override_converts_strings_to_the_type_of_the_field():
    config = override(
        EnvConfig(),
        {"lidar.beam_count": "90", "radio.noise_std_db": "2", "slam.merging.wifi_check": "false", "map": "3"},
    )
    assert (config.lidar.beam_count, config.radio.noise_std_db) == (90, 2.0)
    assert config.slam.merging.wifi_check is False
    assert config.map == "3"


@pytest.mark.parametrize("section", [{"beam_count": 90}, {}])
def test_a_nested_override_leaves_the_other_settings_of_its_section(section):
    config = override(EnvConfig(), {"lidar.range_max_m": 7.0, "lidar": section})
    assert config.lidar == LidarConfig(range_max_m=7.0, **section)
    assert override(config, {"lidar": section}) == config


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        ({"lidra": {}}, r"there is no setting lidra; did you mean 'lidar'\?"),
        ({"robots": {}}, r"robots must be a whole number; got {}"),
        ({"lidar": {"beam_cuont": 9}}, r"there is no setting lidar\.beam_cuont; did you mean 'beam_count'\?"),
        ({"robots.a": 9}, r"there is no setting robots\.a: robots is one value, no table"),
        ({"lidar.beam_cuont": 9}, r"there is no setting lidar\.beam_cuont; did you mean 'beam_count'\?"),
        ({"lidar.beam_count.more": 9}, r"there is no setting lidar\.beam_count\.more"),
        ({"lidar.beam_count": "many"}, r"lidar\.beam_count must be a whole number; got 'many'"),
        ({"lidar": "many"}, r"lidar is a section; set one of lidar\.beam_count, lidar\.range_max_m"),
        ({"slam.merging.wifi_check": "perhaps"}, r"must be true or false; got 'perhaps'"),
        ({"lidar": 3}, r"lidar must be a table of settings; got 3"),
    ],
)
def test_an_invalid_override_is_rejected(assignments, message):
    with pytest.raises(ConfigError, match=message):
        override(EnvConfig(), assignments)


def test_a_run_folder_is_read_as_the_config_in_it(tmp_path):
    config = override(EnvConfig(), {"lidar.beam_count": 90})
    (tmp_path / "config.json").write_text(json.dumps(to_dict(config)), encoding="utf-8")
    assert load(tmp_path) == config
    with pytest.raises(ConfigError, match=r"empty is a folder without config\.json: name a run folder, or a \.toml"):
        (tmp_path / "empty").mkdir()
        load(tmp_path / "empty")


def test_an_invalid_setting_in_a_file_is_named_with_the_file(tmp_path):
    (tmp_path / "mine.toml").write_text("robbots = 3", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine\.toml: there is no setting robbots; did you mean 'robots'\?"):
        load(tmp_path / "mine.toml")


def test_numpy_numbers_and_paths_are_converted(tmp_path):
    values = {"robots": np.int64(2), "map": tmp_path / "a.json", "lidar": {"range_max_m": np.float32(5.0)}}
    read, changed = from_dict(values), override(EnvConfig(), {**values, "lidar": to_dict(EnvConfig())["lidar"]})
    direct = EnvConfig(robots=np.int64(2), map=tmp_path / "a.json")
    for config in (read, changed, direct):
        assert type(config.robots) is int and config.map == str(tmp_path / "a.json")
        assert json.loads(json.dumps(to_dict(config)))["robots"] == 2
    assert type(read.lidar.range_max_m) is float
    with pytest.raises(ConfigError, match=r"robots must be a whole number; got 2\.5"):
        from_dict({"robots": np.float64(2.5)})


def test_a_radio_preset_is_applied_before_other_settings():
    for order in (1, -1):
        settings = dict(list({"radio.preset": "twc", "radio.noise_std_db": "0.5"}.items())[::order])
        assert override(EnvConfig(), settings).radio == dataclasses.replace(radio_preset("twc"), noise_std_db=0.5)


def test_a_lidar_preset_is_applied_before_other_settings():
    config = override(EnvConfig(), {"lidar.beam_count": 90, "lidar.preset": "lms-200"})
    assert config.lidar == dataclasses.replace(lidar_preset("lms-200"), beam_count=90)
    assert from_dict({"lidar": {"preset": "lds-01"}}).lidar == lidar_preset("lds-01")
    with pytest.raises(ConfigError, match=r"lidar.preset must be one of ideal, lds-01, .*; did you mean 'lms-200'\?"):
        override(EnvConfig(), {"lidar.preset": "lms-20"})


def test_settings_added_later_change_the_digest_only_beside_their_default():
    assert digest(override(EnvConfig(), {"lidar.range_min_m": 0.0, "lidar.is_rolling": False})) == digest(EnvConfig())
    assert digest(override(EnvConfig(), {"lidar.range_min_m": 0.1})) != digest(EnvConfig())


def test_override_does_not_change_the_original():
    config = EnvConfig()
    before = digest(config)
    assert override(config, {"robots": 2}).robots == 2
    assert digest(config) == before


@given(st.sampled_from(numeric_fields()), st.floats(0, 1))
def test_the_digest_changes_exactly_when_a_value_does(field, share):
    key, minimum, maximum, is_integer = field
    value = minimum + share * (maximum - minimum)
    usual = override(EnvConfig(), BESIDE.get(key, {}))
    changed = override(usual, {key: round(value) if is_integer else value})
    assert (digest(changed) == digest(usual)) == (changed == usual)


def test_a_config_cannot_be_edited():
    with pytest.raises(dataclasses.FrozenInstanceError):
        EnvConfig().robots = 4


@pytest.mark.parametrize("copied", [lambda c: pickle.loads(pickle.dumps(c)), copy.deepcopy])
def test_copies_are_equal_and_have_the_same_digest(copied):
    config = override(EnvConfig(), {"radio.noise_std_db": 1.5})
    assert copied(config) == config
    assert digest(copied(config)) == digest(config)


def test_toml_and_json_files_give_the_same_config(tmp_path):
    (tmp_path / "a.toml").write_text('map = "twin-02"\n[lidar]\nbeam_count = 90\n')
    (tmp_path / "a.json").write_text('{"map": "twin-02", "lidar": {"beam_count": 90}}')
    assert (
        load(tmp_path / "a.toml")
        == load(str(tmp_path / "a.json"))
        == from_dict({"map": "twin-02", "lidar": {"beam_count": 90}})
    )


@pytest.mark.parametrize("name", ["broken.toml", "broken.json"])
def test_a_file_that_is_no_toml_or_json_is_rejected_by_name(tmp_path, name):
    (tmp_path / name).write_text("{ this is neither")
    with pytest.raises(ConfigError, match=rf"{name} is not valid {name[-4:].upper()}"):
        load(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", b'{"robots": 2, "lidar": {"beam_count": 90, "beam_count": 360}}', r"key 'beam_count' stands twice"),
        ("a.toml", b"robots = 2\nrobots = 3\n", r"not valid TOML: Cannot overwrite a value .*line 2"),
        ("a.toml", b'{"robots": 2}', r"not valid TOML: .*: it looks like JSON, whose name must end in \.json"),
        ("a.toml", "robots = 2".encode("utf-16"), r"a\.toml is UTF-16 text; save it as UTF-8"),
        ("a.json", "{}".encode("utf-16-le"), r"a\.json holds null characters, as UTF-16 text does; save it as UTF-8"),
        ("a.toml", b'map = "caf\xe9"', r"a\.toml is not UTF-8 text; save it as UTF-8"),
        ("a.toml", b"", r"a\.toml is empty; without a file all settings have their defaults"),
        (
            "a.json",
            b"\xef\xbb\xbf\n",
            r"a\.json is empty; .* a \.toml or \.json file such as `twc-env settings",
        ),
        ("a.yaml", b"robots: 2", r"a\.yaml is YAML by its name; settings are a \.toml or \.json file"),
        ("a.json", b"[" * 100_000, r"a\.json nests its values too deeply"),
        ("a.toml", b"a=" + b"[" * 100_000, r"a\.toml nests its values too deeply"),
    ],
)
def test_a_file_that_holds_no_settings_is_rejected_with_the_remedy(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=message) as caught:
        load(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.JSON", b'{"robots": 2}'),
        ("a.toml", b"\xef\xbb\xbfrobots = 2\r\n"),
        ("a.json", b'\xef\xbb\xbf{"robots": 2}'),
        ("a", b"robots = 2"),
    ],
)
def test_settings_are_read_in_spite_of_capitals_byte_order_marks_and_missing_suffixes(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert load(tmp_path / name) == from_dict({"robots": 2})


def test_a_file_of_comments_only_leaves_the_defaults(tmp_path):
    (tmp_path / "a.toml").write_text("# robots = 2\n", encoding="utf-8")
    assert load(tmp_path / "a.toml") == EnvConfig()


def test_a_missing_file_is_rejected_by_name(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot read the config file .*none\.toml"):
        load(tmp_path / "none.toml")


@pytest.mark.parametrize("assignments", [None, ["robots"], {3: 1}])
def test_settings_without_names_are_rejected(assignments):
    with pytest.raises(ConfigError, match="a dict with names as keys"):
        override(EnvConfig(), assignments)


@pytest.mark.parametrize("digits", [400, 5000])
def test_a_number_of_too_many_digits_is_refused_in_one_line(digits):
    for make in (
        lambda: override(EnvConfig(), {"lidar.range_max_m": 10**digits}),
        lambda: LidarConfig(range_max_m=10**digits),
    ):
        with pytest.raises(
            ConfigError,
            match=f"lidar.range_max_m must be a number of at most 300 digits; got one of about {digits + 1}",
        ):
            make()


@pytest.mark.parametrize("name", WORLD_PRESETS)
def test_a_world_is_the_same_from_python_a_table_and_a_file(name, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f'world = "{name}"\nrobots = 2\n')
    expected = override(world_preset(name), {"robots": 2})
    assert load(path) == from_dict({"world": name, "robots": 2}) == override(EnvConfig(), {"world": name, "robots": 2})
    assert load(path) == expected and (name == "clean") == (world_preset(name) == EnvConfig())


def test_other_settings_and_another_radio_go_before_those_of_the_world():
    wanted = {"world": "mall", "people.count": 3, "radio.preset": "radio-indoor"}
    config = override(EnvConfig(), wanted)
    assert config.people.count == 3 and config.people.walking_share == 0.8
    assert config.radio == radio_preset("radio-indoor")
    assert config == from_dict({"world": "mall", "people": {"count": 3}, "radio": {"preset": "radio-indoor"}})


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("world", "dropout", "glass"), [("office", 0.02, 0.6), ("mall", 0.05, 0.3), ("ward", 0.05, 1)])
def test_another_scanner_in_a_world_leaves_its_glass_and_its_lost_returns(world, dropout, glass, order):
    settings = dict([("world", world), ("lidar.preset", "rplidar-a1")][::order])
    config = override(EnvConfig(), settings)
    place = {"dropout_probability": dropout, "glass_return_probability": glass}
    assert config.lidar == dataclasses.replace(lidar_preset("rplidar-a1"), **place)
    assert config == from_dict({"world": world, "lidar": {"preset": "rplidar-a1"}})
    assert config == override(world_preset(world), {"lidar.preset": "rplidar-a1"}), "a file of that world"
    assert override(config, {"world": "clean"}) == override(EnvConfig(), {"lidar.preset": "rplidar-a1"})


def test_another_scanner_leaves_nothing_that_no_world_has_set():
    config = override(EnvConfig(), {"lidar.dropout_probability": 0.3, "lidar.mirror_probability": 0.5})
    assert override(config, {"lidar.preset": "lms-200"}).lidar == lidar_preset("lms-200")
    ward = override(world_preset("ward"), {"lidar.glass_return_probability": 0.2})
    assert override(ward, {"lidar.preset": "lms-200"}).lidar.glass_return_probability == 1.0


@pytest.mark.parametrize("before", [name for name in WORLD_PRESETS if name != "clean"])
@pytest.mark.parametrize("after", WORLD_PRESETS)
def test_another_world_leaves_nothing_of_the_one_before(before, after):
    own = {"robots": 2, "lidar.beam_count": 90}
    config = override(EnvConfig(), {"world": before, **own})
    assert world_of(config) == before
    assert override(config, {"world": after}) == override(EnvConfig(), {"world": after, **own})


def test_another_world_keeps_what_somebody_else_has_set():
    own = {"people.count": 7, "slam.place_recognition.recogniser": "fused"}
    assert override(override(EnvConfig(), own), {"world": "clean"}) == override(EnvConfig(), own)
    in_ward = override(EnvConfig(), {"world": "ward", "people.count": 7})
    assert world_of(in_ward) == "ward" and override(in_ward, {"world": "clean"}).people.count == 7
    assert world_of(EnvConfig()) == "clean"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lidar.range_min_m": 3.0, "lidar.range_max_m": 2.0}, "the scanner would see nothing"),
        ({"failure.robots": 3, "robots": 2}, r"failure\.robots is 3, and robots is 2"),
        ({"failure.link_begin_step": 100, "failure.link_end_step": 50}, "set a later end"),
        ({"robot": "handheld", "team": "twc-slam"}, "give one of them"),
        ({"team": ""}, "turtlebots, or robots such as 'handheld, wheeled', of wheeled"),
        ({"robot": [{"people.count": 3}]}, "set it for the team"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        override(EnvConfig(), settings)
    if "." not in "".join(settings):
        with pytest.raises(ConfigError, match=message):
            from_dict(settings)


def test_an_unknown_world_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"world must be one of clean, office, .*did you mean 'ward'"):
        override(EnvConfig(), {"world": "wardd"})
    with pytest.raises(ConfigError) as error:
        override(EnvConfig(), {"world": "Mall"})
    assert str(error.value).count("warehouse") == 1


def test_a_setting_that_is_gone_is_read_at_its_last_value_only():
    gone = "slam.place_recognition.meets_by_wifi"
    assert from_dict({"slam": {"place_recognition": {"meets_by_wifi": False}}}) == EnvConfig()
    with pytest.raises(ConfigError, match=f"there is no setting {gone}"):
        override(EnvConfig(), {gone: True})


@pytest.mark.parametrize(
    ("typed", "meant"), [("Quick", "; did you mean 'ExploreQuick-v1'?"), ("ore", ""), ("v1", ""), ("", "")]
)
def test_an_unknown_name_is_answered_with_the_only_one_that_contains_it(typed, meant):
    assert did_you_mean(typed, ["ExploreQuick-v1", "ExploreWarehouses-v1"]) == meant


def test_an_unknown_name_is_answered_with_the_few_that_begin_alike_or_with_all():
    names = ["beam_count", "beam_divergence_rad", "range_max_m"]
    meant, known = "; did you mean 'beam_count' or 'beam_divergence_rad'?", f"; known are {', '.join(names)}"
    assert one_of("noise", names) == known
    assert one_of("beams", names) == known + meant
    assert one_of("beams", [*names, *"abcdef"]) == meant


def test_a_name_without_its_section_is_answered_with_the_whole_one_and_a_dotted_one_with_a_table():
    with pytest.raises(ConfigError, match=r"no setting frontier_slots; did you mean action\.frontier_slots"):
        from_dict({"frontier_slots": 4})
    with pytest.raises(ConfigError, match=r"no setting action\.kind here: write a table 'action' for what follows"):
        from_dict({"action.kind": "frontier"})


@pytest.mark.parametrize(
    ("section", "old", "new"),
    [("keyframe", "mask_mates", "mask_teammates"), ("merging", "sightings_check", "mutual_observations_check")],
)
def test_a_renamed_setting_names_the_new_one_wherever_it_stands(section, old, new, tmp_path):
    told = f"there is no setting slam.{section}.{old}: it is now {new}"
    (tmp_path / "old.toml").write_text(f"[slam.{section}]\n{old} = true\n")
    for give in (
        lambda: override(EnvConfig(), {f"slam.{section}.{old}": "true"}),
        lambda: from_dict({"slam": {section: {old: True}}}),
        lambda: load(tmp_path / "old.toml"),
    ):
        with pytest.raises(ConfigError, match=told):
            give()
