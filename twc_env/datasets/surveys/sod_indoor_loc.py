"""SODIndoorLoc (Bi et al. 2022): WiFi fingerprints of office floors with known access points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.surveys.fingerprints import RadioSurvey, heard_only, numbers, read_table
from twc_env.errors import DataError

_PLACE = ("ECoord", "NCoord", "FloorID", "SceneID", "PhoneID", "SampleTimes")
_ACCESS_POINT = ("ECoord", "NCoord", "FloorID", "Attribute_2.4", "Attribute_5")


def read_sod(folder: str | Path, building: str) -> RadioSurvey:
    """One building, such as "CETC331": the first sample of every point and all access points of known position.

    Read are `Training_BUILDING*.csv` (also .gz) and `aps_BUILDING.csv`. Other samples of a point are mostly repeated
    scans. Scans of one phone count as one walk. Raises DataError for unknown names and invalid files.
    """
    files = sorted(Path(folder).glob("Training_*.csv*"))
    mine = [file for file in files if file.name.split(".")[0].removeprefix("Training_").split("_")[0] == building]
    if not mine:
        known = sorted({file.name.split(".")[0].split("_")[1] for file in files})
        raise DataError(
            f"{folder} has no Training_{building}*.csv.gz of SODIndoorLoc; buildings there are "
            f"{', '.join(known) or 'none'}"
        )
    path, aps_path = mine[0], Path(folder) / f"aps_{building}.csv"
    header, rows, lines = read_table(path, _PLACE)
    at = {name: i for i, name in enumerate(header)}
    table = numbers(rows, lines, path, [at[name] for name in _PLACE])
    _, first = np.unique(table[:, [at[name] for name in _PLACE[:3]]], axis=0, return_index=True)
    table = table[np.sort(first)]
    aps_header, aps, aps_lines = read_table(aps_path, _ACCESS_POINT)
    sent = [
        (dict(zip(aps_header, ap, strict=True))[band], (line, ap), band == "Attribute_5")
        for line, ap in zip(aps_lines, aps, strict=True)
        for band in _ACCESS_POINT[3:]
    ]
    sent = [(mac, ap, is_high) for mac, ap, is_high in sent if mac in at]
    if not sent:
        raise DataError(f"{aps_path} names no address of {path.name}; wrong pair of files")
    place_at = [aps_header.index(key) for key in _ACCESS_POINT[:3]]
    placed = [[ap[k] for k in place_at] for _, (_, ap), _ in sent]
    places = numbers(placed, [line for _, (line, _), _ in sent], aps_path)
    return RadioSurvey(
        name=f"sod/{building}",
        position_m=table[:, [at["ECoord"], at["NCoord"]]],
        floor=table[:, at["FloorID"]].astype(int),
        time_s=np.zeros(len(table)),
        walk=table[:, at["PhoneID"]].astype(int),
        addresses=tuple(mac for mac, _, _ in sent),
        rssi_dbm=heard_only(table[:, [at[mac] for mac, _, _ in sent]]),
        transmitter_m=places[:, :2],
        transmitter_floor=places[:, 2].astype(int),
        is_high_band=np.array([is_high for _, _, is_high in sent]),
        room_kind=table[:, at["SceneID"]].astype(int),
    )
