"""Files of maps that last (docs/lasting_maps.md): arrays and JSON only, nothing in them can run code."""

from __future__ import annotations

import json
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray as Array

from twc_env._version import __version__
from twc_env.config import EnvConfig
from twc_env.config.slam import EARLIER_SESSION
from twc_env.datasets.logs.arrays_file import REAL, TEXT, TRUTH_VALUE, WHOLE, fault_of_types, read_arrays, write_arrays
from twc_env.errors import UNFIT, DataError
from twc_env.records.input_file import input_path
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import Fingerprint, GridMap, SignObservation

FORMAT = "twc_env/lasting-map-1"
REMEDY = "save the map again"
FAR_M = 1e6
"""No place of a building is so far from its map's origin; cells there have no number."""
_PLACES = ("poses", "scans_m", "sign_places_m", "edge_measured", "grid_origin_m")
_TYPES = {
    TEXT: ("header",),
    WHOLE: ("sessions_of", "sign_counts", "sign_texts", "mac_counts", "macs", "edge_ends", "grid"),
    REAL: (
        "poses", "scans_m", "sign_places_m", "sign_facings_rad", "rssi_dbm", "edge_measured", "edge_information",
        "grid_origin_m",
    ),
    TRUTH_VALUE: ("is_closure",),
}  # fmt: skip
_ARRAYS = tuple(name for names in _TYPES.values() for name in names)
_NUMBERS = ("range_max_m", "resolution_m", "sessions", "texts")
"""Keys of the header that a reader needs."""


def write_lasting_map(path: str | Path, lasting: LastingMap) -> int:
    """Write a map to a sealed .npz file, whole or not at all; returns its size in bytes. Raises DataError if it cannot
    be written."""
    texts = sorted({sign.text for signs in lasting.signs for sign in signs})
    number_of = {text: k for k, text in enumerate(texts)}
    signs = [sign for own in lasting.signs for sign in own]
    heard = lasting.fingerprints
    header = {
        "keyframes": len(lasting.poses),
        "range_max_m": float(lasting.range_max_m),
        "resolution_m": float(lasting.grid.resolution_m),
        "sessions": int(lasting.sessions),
        "texts": texts,
        "version": __version__,
    }
    try:
        write_arrays(
            path,
            format=np.array(FORMAT),
            header=np.array(json.dumps(header, sort_keys=True)),
            poses=lasting.poses,
            scans_m=lasting.scans_m.astype(np.float32),
            sessions_of=lasting.sessions_of.astype(np.int32),
            sign_counts=np.array([len(own) for own in lasting.signs], np.int32),
            sign_texts=np.array([number_of[sign.text] for sign in signs], np.int32),
            sign_places_m=np.array([sign.position_m for sign in signs], np.float32).reshape(-1, 2),
            sign_facings_rad=np.array([sign.facing_rad for sign in signs], np.float32),
            mac_counts=np.array([len(print_.macs) for print_ in heard], np.int32),
            macs=np.concatenate([np.zeros(0, np.int64), *(print_.macs for print_ in heard)]),
            rssi_dbm=np.concatenate([np.zeros(0), *(print_.rssi_dbm for print_ in heard)]).astype(np.float32),
            edge_ends=lasting.edge_ends.astype(np.int32),
            edge_measured=lasting.edge_measured,
            edge_information=lasting.edge_information,
            is_closure=lasting.is_closure,
            grid=lasting.grid.log_odds.astype(np.int16),
            grid_origin_m=np.asarray(lasting.grid.origin_m, float),
        )
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another place") from error
    return Path(path).stat().st_size


class Mapper(Protocol):
    """Whatever can give its map, such as an engine."""

    def lasting_map(self) -> LastingMap:
        """The map so far."""

    @property
    def unsaved_robots(self) -> tuple[int, ...]:
        """Robots whose map is another one."""


def save_map(path: str | Path, engine: Mapper) -> str:
    """Write the map of an engine to a file; returns what there is to say about it, its size first, and whose map is not
    in it. Raises DataError if there is no map, or the file cannot be written."""
    lasting = engine.lasting_map()
    size = write_lasting_map(path, lasting)
    texts = {sign.text for signs in lasting.signs for sign in signs}
    left = engine.unsaved_robots
    return (
        f"{path} ({size / 1000:,.0f} kB: {len(lasting.poses)} keyframes of {lasting.sessions} session"
        f"{'s' * (lasting.sessions != 1)}, {len(texts)} sign texts)"
        + f"; without the map of robot{'s' * (len(left) > 1)} {', '.join(map(str, left))}"
        * bool(left)
    )


def read_lasting_map(path: str | Path) -> LastingMap:
    """A map as `write_lasting_map` wrote it. Raises DataError if the file is missing, damaged, of another kind or of
    another version of the format."""
    arrays = read_arrays(path, "saved map", FORMAT, _ARRAYS, REMEDY)
    try:
        header = json.loads(str(arrays["header"]))
        missing = [key for key in _NUMBERS if key not in header]
        fault = f"a header without {', '.join(missing)}" if missing else _fault(arrays, header)
    except (AttributeError, *UNFIT) as error:
        fault = f"a header that is no JSON object ({error})"
    if fault is not None:
        raise DataError(f"{path} contradicts itself: {fault}; {REMEDY}")
    return _unpacked(arrays, header)


def _fault(arrays: dict[str, Array], header: dict) -> str | None:
    """The first inconsistency of the arrays, or None."""
    if fault := fault_of_types(arrays, _TYPES):
        return fault
    count, edges, signs, heard = (len(np.atleast_1d(arrays[k])) for k in ("poses", "is_closure", "sign_texts", "macs"))
    beams = arrays["scans_m"].shape[1] if arrays["scans_m"].ndim == 2 else 0
    shapes = {
        "poses": (count, 3), "scans_m": (count, beams), "sessions_of": (count,), "sign_counts": (count,),
        "mac_counts": (count,), "sign_texts": (signs,), "sign_places_m": (signs, 2), "sign_facings_rad": (signs,),
        "macs": (heard,), "rssi_dbm": (heard,), "edge_ends": (edges, 2), "edge_measured": (edges, 3),
        "edge_information": (edges, 3, 3), "is_closure": (edges,), "grid_origin_m": (2,),
    }  # fmt: skip
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            return f"{name} of shape {arrays[name].shape}, {shape} is possible"
        if arrays[name].dtype.kind == "f" and name != "sign_facings_rad" and not np.isfinite(arrays[name]).all():
            return f"{name} that are not finite"
        if name in _PLACES and np.abs(arrays[name]).max(initial=0.0) >= FAR_M:
            return f"{name} up to {np.abs(arrays[name]).max():.3g} m, and {FAR_M:.0e} m is too far"
    if arrays["grid"].ndim != 2 or (arrays["grid"].size and np.abs(arrays["grid"].astype(np.int64)).max() > 1000):
        return f"a grid of shape {arrays['grid'].shape} and type {arrays['grid'].dtype}"
    if count == 0 or beams == 0:
        return "no keyframes"
    for name, total in (("sign_counts", signs), ("mac_counts", heard)):
        if arrays[name].min() < 0 or arrays[name].sum() != total:
            return f"{name} counts {arrays[name].sum()}, and there are {total}"
    texts = header["texts"]
    if not (isinstance(texts, list) and all(isinstance(text, str) for text in texts)):
        return "texts in the header that are no list of texts"
    for name, end in (("sign_texts", len(texts)), ("edge_ends", count)):
        if arrays[name].size and not 0 <= arrays[name].min() <= arrays[name].max() < end:
            return f"{name} up to {arrays[name].max()}, and there are {end}"
    for key in ("range_max_m", "resolution_m", "sessions"):
        if isinstance(header[key], bool) or not isinstance(header[key], (int, float)) or not 0 < header[key] < 1e6:
            return f"{key} = {header[key]!r} in the header"
    return None


def _unpacked(arrays: dict[str, Array], header: dict) -> LastingMap:
    texts, places, facings = header["texts"], arrays["sign_places_m"].astype(float), arrays["sign_facings_rad"]
    signs = [
        SignObservation(texts[number], place, float(facing))
        for number, place, facing in zip(arrays["sign_texts"].tolist(), places, facings.tolist(), strict=True)
    ]
    ends, heard_ends = np.cumsum(arrays["sign_counts"]).tolist(), np.cumsum(arrays["mac_counts"])[:-1]
    macs = np.split(arrays["macs"].astype(np.int64), heard_ends)
    rssi_dbm = np.split(arrays["rssi_dbm"].astype(float), heard_ends)
    grid = np.ascontiguousarray(arrays["grid"].astype(np.int16))
    return LastingMap(
        poses=arrays["poses"].astype(float),
        scans_m=arrays["scans_m"].astype(float),
        sessions_of=arrays["sessions_of"].astype(np.int64),
        signs=tuple(tuple(signs[first:end]) for first, end in zip([0, *ends[:-1]], ends, strict=True)),
        fingerprints=tuple(Fingerprint(*heard) for heard in zip(macs, rssi_dbm, strict=True)),
        edge_ends=arrays["edge_ends"].astype(np.int64),
        edge_measured=arrays["edge_measured"].astype(float),
        edge_information=arrays["edge_information"].astype(float),
        is_closure=arrays["is_closure"],
        grid=GridMap(grid, arrays["grid_origin_m"].astype(float), float(header["resolution_m"])),
        range_max_m=float(header["range_max_m"]),
        sessions=int(header["sessions"]),
    )


def prior_of(config: EnvConfig) -> LastingMap | None:
    """The map that `slam.prior` names; None without one. Raises DataError as `read_lasting_map`, MapError for a ROS map
    that cannot be read."""
    if not config.slam.prior:
        return None
    if config.slam.prior.startswith(EARLIER_SESSION + ":"):
        raise DataError(f"slam.prior is {config.slam.prior!r}, a map that an environment makes; name a file by --prior")
    try:
        state = input_path(config.slam.prior).stat()
    except OSError as error:
        raise DataError(f"cannot read the saved map {config.slam.prior}: {error.strerror}; {REMEDY}") from error
    if _is_ros_map(config.slam.prior):
        grid = _ros_grid(config.slam.prior)
        return LastingMap.of_grid(grid, config.lidar.circle_beam_count, float(config.lidar.range_max_m))
    return _read_once(config.slam.prior, state.st_mtime_ns, state.st_size)


def prior_digest(config: EnvConfig) -> str:
    """Digest (eight hex digits) of the content of the file that `slam.prior` names; empty if it names none. Raises the
    errors of `prior_of`."""
    name = config.slam.prior
    if not name or name.startswith(EARLIER_SESSION + ":"):
        return ""
    if _is_ros_map(name):
        grid = _ros_grid(name)
        place = np.append(np.asarray(grid.origin_m, float), [grid.resolution_m, *grid.log_odds.shape])
        return sha256(place.tobytes() + np.ascontiguousarray(grid.log_odds).tobytes()).hexdigest()[:8]
    try:
        return sha256(input_path(name).read_bytes()).hexdigest()[:8]
    except OSError as error:
        raise DataError(f"cannot read the saved map {name}: {error.strerror}; {REMEDY}") from error


def _is_ros_map(name: str) -> bool:
    return Path(name).suffix.lower() in (".yaml", ".yml")


def _ros_grid(name: str) -> GridMap:
    from twc_env.datasets.buildings.ros_map import read_ros_grid  # slow to import: scipy

    return read_ros_grid(name)


@lru_cache(maxsize=4)
def _read_once(path: str, _changed_ns: int, _size: int) -> LastingMap:
    """The map of a file in this state: episodes after one another read it once."""
    return read_lasting_map(path)
