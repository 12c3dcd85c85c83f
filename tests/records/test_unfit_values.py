"""Numbers that no float holds, and JSON nested too deeply, are refused like any other unfit value."""

import json

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.datasets.logs.scan_log import read_scan_log
from twc_env.errors import ActionError, ConfigError, DataError
from twc_env.maps import load_map
from twc_env.pictures.replay_page import read_report
from twc_env.records.array_validation import validated_points, validated_pose
from twc_env.records.fingerprint_validation import validated_fingerprint
from twc_env.records.messages import Fingerprint
from twc_env.slam.radio.radio_slam import RadioLog
from twc_env.suite.gaps import _seed_of
from twc_env.world.world import World

HUGE = 10**400
DEEP = "[" * 200_000


def test_numbers_that_no_float_holds_are_named():
    empty = Fingerprint(np.zeros(0, np.int64), np.zeros(0))
    for work, told in (
        (lambda: validated_pose([0, 0, HUGE], "start"), "start must be a finite pose"),
        (lambda: validated_points([[0, HUGE]]), "points must be numbers"),
        (lambda: validated_fingerprint(Fingerprint([1], [-HUGE])), "the fingerprint must hold numbers"),
        (lambda: RadioLog([[0, 0, HUGE]], [0.0], [empty, empty]), "motions and turns must be numbers"),
    ):
        with pytest.raises(DataError, match=told):
            work()


def test_a_world_refuses_starts_and_commands_that_no_float_holds():
    config = override(EnvConfig(), {"robots": 1})
    world = World(config, load_map("twin-01"))
    with pytest.raises(ConfigError, match="starts must be"):
        world.reset(0, starts=[[0, 0, HUGE]])
    world.reset(0)
    with pytest.raises(ActionError, match="commands must be finite"):
        world.step([[0, HUGE]])


@pytest.mark.parametrize("key", ["x", "range"])
def test_a_log_in_json_with_such_a_number_is_refused_in_one_line(tmp_path, key):
    scan = {"range": [1.0, 2.0], "x": 0.0, "y": 0.0, "theta": 0.0}
    scan[key] = [HUGE, 1] if key == "range" else HUGE
    (tmp_path / "a.json").write_text(json.dumps({"map": {"0": scan}}))
    with pytest.raises(DataError, match=r"a\.json is not a scan log: int too large"):
        read_scan_log(tmp_path / "a.json")


def test_json_that_is_nested_too_deeply_is_no_report_and_names_no_seed(tmp_path):
    (tmp_path / "report.json").write_text(DEEP)
    (tmp_path / "config.json").write_text(DEEP)
    with pytest.raises(DataError, match="is not valid JSON"):
        read_report(tmp_path / "report.json")
    assert _seed_of(str(tmp_path)) is None
