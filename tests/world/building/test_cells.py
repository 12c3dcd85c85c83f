"""LTE cells outside the building, and the named presets of all radios."""

import dataclasses

import numpy as np
import pytest

from twc_env.config import (
    RADIO_PRESETS,
    CellConfig,
    EnvConfig,
    RadioConfig,
    from_dict,
    override,
    radio_preset,
)
from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.world.sensors.radio import CELL_BAND, CELL_ID_MIN, RadioModel
from twc_env.world.sensors.reception import WifiReceiver

QUIET = {"shadowing_std_db": 0.0, "fading_std_db": 0.0, "device_offset_std_db": 0.0, "noise_std_db": 0.0}


def lte_model(plan=None, **cells) -> RadioModel:
    quiet = {"count": 30, "shadowing_std_db": 0.0, **cells}
    config = RadioConfig(**QUIET, wifi=False, power_spread_db=0.0, cells=CellConfig(**quiet))
    return RadioModel(config, plan or load_map("twin-01"))


def test_cells_have_unique_numbers_and_the_configured_distances():
    model = lte_model(distance_min_m=300.0, distance_max_m=900.0)
    low_x, low_y, high_x, high_y = load_map("twin-01").bounds_m
    away = np.linalg.norm(model._sources.position_m - [(low_x + high_x) / 2, (low_y + high_y) / 2], axis=1)
    assert model.macs.tolist() == [CELL_ID_MIN + k for k in range(30)]
    assert (model.band_of == CELL_BAND).all()
    assert away.min() >= 300.0 and away.max() <= 900.0


def test_cells_are_attenuated_by_distance_walls_and_antenna_angle():
    plan = load_map("twin-01")
    model, opened = lte_model(plan), lte_model(plan, wall_loss_factor=0.0)
    place = np.array([15.0, 1.2])
    masts = model._sources.position_m
    aim = np.arctan2(*(place - masts).T[::-1]) - model._aim_rad
    off = np.abs((aim + np.pi) % (2 * np.pi) - np.pi)
    expected = -8.0 - 35.0 * np.log10(np.linalg.norm(masts - place, axis=1))
    expected -= np.minimum(12.0 * (off / np.deg2rad(65.0)) ** 2, 20.0)
    assert opened.mean_rssi_dbm(place) == pytest.approx(expected)
    loss = opened.mean_rssi_dbm(place) - model.mean_rssi_dbm(place)
    walls = np.array([plan.wall_index.crossing(place, mast[None])[1][0] for mast in masts])
    assert loss == pytest.approx(walls)


def test_a_phone_lists_only_the_strongest_cells():
    cells = CellConfig(count=30, detection_floor_dbm=-160.0, listed_max=7)
    config = RadioConfig(**QUIET, wifi=False, cells=cells)
    model = RadioModel(config, load_map("twin-01"))
    place = np.array([15.0, 1.2])
    scan = WifiReceiver(config, model, 0, 1).scan(place)
    everything = dataclasses.replace(config, cells=dataclasses.replace(cells, listed_max=0))
    all_heard = WifiReceiver(everything, model, 0, 1).scan(place)
    assert len(scan.macs) == 7 < len(all_heard.macs)
    assert sorted(scan.rssi_dbm) == sorted(all_heard.rssi_dbm)[-7:]


@pytest.mark.parametrize("changes", [{}, {"fading_shared": True, "high_band": {"share": 0.5}}, {"sweep_share": 0.7}])
def test_cells_leave_the_readings_of_wifi_as_they_are(changes):
    places = np.column_stack([np.linspace(3.0, 27.0, 90), np.full(90, 1.2)])
    heard = []
    for count in (0, 1, 7):
        config = from_dict({"radio": {**changes, "cells": {"count": count, "detection_floor_dbm": -160.0}}}).radio
        receiver = WifiReceiver(config, RadioModel(config, load_map("twin-01")), 1, 5)
        scans = [receiver.scan(place, 0.5 * k) for k, place in enumerate(places)]
        heard.append([dict(zip(scan.macs.tolist(), scan.rssi_dbm.tolist(), strict=True)) for scan in scans])
        assert any(mac >= CELL_ID_MIN for scan in heard[-1] for mac in scan) == (count > 0)
    wifi = [[{mac: dbm for mac, dbm in scan.items() if mac < CELL_ID_MIN} for scan in scans] for scans in heard]
    assert wifi[0] == wifi[1] == wifi[2]


def test_cells_move_with_the_building():
    plan = load_map("twin-01")
    moved = plan.moved([30.0, -8.0, 2.0])
    here = np.array([3.0, 1.0])
    there = np.array([30.0, -8.0]) + np.array([[np.cos(2), -np.sin(2)], [np.sin(2), np.cos(2)]]) @ here
    assert lte_model(moved).mean_rssi_dbm(there) == pytest.approx(lte_model(plan).mean_rssi_dbm(here), abs=1e-6)


@pytest.mark.parametrize("name", sorted(RADIO_PRESETS))
def test_every_preset_receives_signals_on_the_twin_map(name):
    config = radio_preset(name)
    receiver = WifiReceiver(config, RadioModel(config, load_map("twin-01")), 0, 1)
    macs = np.concatenate([receiver.scan(np.array([x, 1.2])).macs for x in (3.0, 9.0, 15.0, 21.0, 27.0)])
    assert len(np.unique(macs)) >= 4
    assert (macs >= CELL_ID_MIN).all() == (name == "lte")


def test_presets_are_loaded_by_name_and_changed_by_key():
    config = from_dict({"radio": {"preset": "lte", "noise_std_db": 0.5, "cells": {"count": 12}}})
    assert config.radio == dataclasses.replace(
        radio_preset("lte"), noise_std_db=0.5, cells=dataclasses.replace(radio_preset("lte").cells, count=12)
    )
    assert override(EnvConfig(), {"radio.preset": "sfw"}).radio == radio_preset("sfw")
    assert radio_preset("twc") == RadioConfig()


def test_an_unknown_preset_is_rejected_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'radio-indoor'"):
        radio_preset("radio-indor")
