"""Settings that are valid, but do nothing or harm beside others, are remarked upon."""

import pytest

from twc_env import TASKS
from twc_env.config import EnvConfig, override
from twc_env.config.remarks import remarks_on
from twc_env.exploration import settings
from twc_env.reproduce.twc.lidar_effects import EFFECTS
from twc_env.reproduce.twc.reality import ALL, WORLDS, settings_of
from twc_env.reproduce.twc.reality import EFFECTS as REALITY
from twc_env.tasks import task_config

CARRIED = {"failure.kidnap_step": 150}


@pytest.mark.parametrize(
    ("given", "needs"),
    [
        ({"building.glass_share": 0.5}, {"lidar.glass_return_probability": 0.3}),
        ({"lidar.dark_share": 0.5}, {"lidar.detection_range_m": 12.0}),
        ({"lidar.dark_share": 0.5}, {"robot": [{"lidar.detection_range_m": 12.0}, {}]}),
        ({"clutter.hidden_share": 0.5}, {"clutter.furniture": 5}),
        ({"world": "warehouse", "clutter.furniture": 0}, {"clutter.furniture": 5}),
    ],
)
def test_a_setting_that_does_nothing_alone_is_named_with_the_one_that_it_needs(given, needs):
    (remark,) = remarks_on(override(EnvConfig(), given))
    named = "clutter.hidden_share" if "world" in given else next(iter(given))
    assert remark.startswith(f"{named} = ") and " does nothing while " in remark
    assert next(iter(needs)).removeprefix("robot") in remark
    assert remarks_on(override(EnvConfig(), given | needs)) == []


@pytest.mark.parametrize("carried", [CARRIED, {"failure.kidnaps_per_min": 0.5}])
@pytest.mark.parametrize(
    "blind",
    [
        {"link.scan_on_request": True},
        {"slam.cues.lidar": False},
        {"slam.radio_slam.online": True},
        {"slam.oracle": "starts"},
        {"slam.odometry_filter.backend": "filterpy"},
    ],
)
def test_carried_robots_that_nobody_notices_are_named_with_what_hides_them(carried, blind):
    (remark,) = remarks_on(override(EnvConfig(), carried | blind))
    assert "nobody notices" in remark
    assert all(f"{key} = " in remark for key in carried | blind)
    assert remarks_on(override(EnvConfig(), carried)) == remarks_on(override(EnvConfig(), blind)) == []
    assert remarks_on(override(EnvConfig(), carried | blind | {"slam.mode": "off"})) == []


def test_tasks_and_published_effects_draw_no_remark():
    configs = [task_config(task) for task in TASKS]
    configs += [override(EnvConfig(), own) for own in EFFECTS.values()]
    configs += [override(EnvConfig(), settings_of(effect)) for effect in (*REALITY, ALL, *WORLDS)]
    assert [remark for config in configs for remark in remarks_on(config)] == []


def test_a_remark_is_logged_once_per_process(caplog):
    settings._warn.cache_clear()
    for _ in range(2):
        settings.resolve({"failure.kidnap_step": 150, "link.scan_on_request": True}, None, {})
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert "failure.kidnap_step = 150" in record.getMessage() and "link.scan_on_request" in record.getMessage()
