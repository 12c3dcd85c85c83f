"""Which cues a robot may place itself by: texts, WiFi, LTE and laser, in any combination (`CuesConfig`).

What a cue told is taken out of the frames before the engine sees them, and the engine's settings are changed to what is
left: without laser nothing is matched and walls judge nothing (scans are still drawn); signs then close loops by
themselves, and radio ties places to each other in the pose graph.
"""

from __future__ import annotations

import dataclasses

from twc_env.class_file import is_in_file
from twc_env.config import CuesConfig, EnvConfig, PlaceRecognitionConfig
from twc_env.messages import SensorFrame, WifiScan
from twc_env.slam.radio_similarity import CELL_ID_MIN


def needed(config: EnvConfig) -> EnvConfig:
    """The configuration of an engine that has only the configured cues; with all of them, as it is."""
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
    """The recogniser that makes most of the cues there are."""
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


def heard(frame: SensorFrame, cues: CuesConfig) -> SensorFrame:
    """The frame without what the robot may not use; laser ranges stay, they are needed to drive and to draw."""
    wifi = frame.wifi
    if wifi is not None and not (cues.wifi and cues.lte):
        is_cell = wifi.macs >= CELL_ID_MIN
        kept = (is_cell & cues.lte) | (~is_cell & cues.wifi)
        age = None if wifi.age_s is None else wifi.age_s[kept]
        wifi = WifiScan(wifi.macs[kept], wifi.rssi_dbm[kept], age)
    return dataclasses.replace(frame, wifi=wifi, signs=frame.signs if cues.text else ())
