"""Restriction of the engine to some cues: texts, WiFi, LTE and laser, in any combination (`CuesConfig`).

Readings of disabled cues are removed from the frames, and the engine's settings are adapted. Without laser there is no
scan matching and no check of merges by walls (scans are still drawn); signs then make closures without verification,
and radio similarity adds edges to the pose graph.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from twc_env.config import CuesConfig, EnvConfig, PlaceRecognitionConfig
from twc_env.records.class_file import is_in_file
from twc_env.records.messages import SensorFrame, WifiScan
from twc_env.slam.radio.radio_similarity import CELL_ID_MIN


def restricted_config(config: EnvConfig) -> EnvConfig:
    """The configuration adapted to the enabled cues; unchanged if all are enabled."""
    cues, slam = config.slam.cues, config.slam
    if cues == CuesConfig():
        return config
    merging = dataclasses.replace(slam.merging, wifi_check=slam.merging.wifi_check and cues.wifi)
    if not cues.lidar:
        merging = dataclasses.replace(merging, contradiction_max=1.0)
    radio = slam.radio_slam
    radio = dataclasses.replace(radio, online=(cues.wifi or cues.lte) and (radio.online or not cues.lidar))
    return dataclasses.replace(
        config,
        slam=dataclasses.replace(
            slam, place_recognition=_recognition(slam.place_recognition, cues), merging=merging, radio_slam=radio
        ),
    )


def _recognition(rule: PlaceRecognitionConfig, cues: CuesConfig) -> PlaceRecognitionConfig:
    """Settings with the recogniser that uses most of the enabled cues."""
    if is_in_file(rule.recogniser):
        return rule if cues.lidar else dataclasses.replace(rule, proximity_m=0.0)
    if not cues.lidar:
        name = "twc" if rule.recogniser == "twc" and cues.wifi else "text"
        return dataclasses.replace(rule, recogniser=name, proximity_m=0.0)
    name = rule.recogniser
    if name == "twc" and not (cues.text and cues.wifi):
        name = "text" if cues.text else "wifi"
    if (name == "text" and not cues.text) or (name == "wifi" and not cues.wifi):
        name = "lidar"
    return dataclasses.replace(rule, recogniser=name)


def restricted_frame(frame: SensorFrame, cues: CuesConfig) -> SensorFrame:
    """The frame without the readings of disabled cues; laser ranges stay, for navigation and drawing."""
    wifi = frame.wifi
    if wifi is not None and not (cues.wifi and cues.lte):
        macs, rssi_dbm = np.asarray(wifi.macs), np.asarray(wifi.rssi_dbm)
        is_cell = macs >= CELL_ID_MIN
        kept = (is_cell & cues.lte) | (~is_cell & cues.wifi)
        age = None if wifi.age_s is None else np.asarray(wifi.age_s)[kept]
        wifi = WifiScan(macs[kept], rssi_dbm[kept], age)
    return dataclasses.replace(frame, wifi=wifi, signs=frame.signs if cues.text else ())
