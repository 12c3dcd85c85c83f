"""What a file is that is no log, told by its beginning, and what would work instead."""

from __future__ import annotations

import math
import re
import zipfile
from pathlib import Path

from twc_env.datasets.logs.readings_table import SIGN_COLUMNS, WIFI_COLUMNS
from twc_env.datasets.logs.text_file import first_bytes, text_encoding
from twc_env.datasets.logs.text_table import is_header
from twc_env.errors import DataError

_LASER = "a log of 2D scans with odometry is needed: a ROS bag, CARMEN, or frames.npz"
_CLOUD = f"holds 3D points of single scans or of a whole scene, without odometry; {_LASER}"
_DRIVER = f"convert it with the scanner's ROS driver; {_LASER}"
_ARRAYS = "write_frame_log of twc_env.datasets makes a log of arrays (docs/frames.md)"
_BAG = "rename it so that its name ends in"
_UNPACK = {".gz": "gunzip", ".xz": "unxz"}
_MAGIC: tuple[tuple[bytes, str, str], ...] = (
    (b"#ROSBAG V2.0", "a ROS 1 bag", f"{_BAG} .bag"),
    (b"#ROSRECORD", "a ROS bag of version 1.1 or older", "convert it: rosbag migrate"),
    (b"SQLite format 3", "an SQLite file, as ROS 2 bags are", f"{_BAG} .db3"),
    (b"\x89MCAP0", "an MCAP file, as ROS 2 bags are", f"{_BAG} .mcap"),
    (b"\xd4\xc3\xb2\xa1", "a network capture (.pcap) of a scanner", _DRIVER),
    (b"\xa1\xb2\xc3\xd4", "a network capture (.pcap) of a scanner", _DRIVER),
    (b"\x4d\x3c\xb2\xa1", "a network capture (.pcap) of a scanner", _DRIVER),
    (b"\x0a\x0d\x0d\x0a", "a network capture (.pcapng)", _DRIVER),
    (b"ply\n", "a PLY cloud", _CLOUD),
    (b"ply\r\n", "a PLY cloud", _CLOUD),
    (b"LASF", "a LAS/LAZ cloud", _CLOUD),
    (b"# .PCD", "a PCD cloud", _CLOUD),
    (b"VERSION .7\nFIELDS", "a PCD cloud", _CLOUD),
    (b"ASTM-E57", "an E57 cloud", _CLOUD),
    (b"\x89PNG", "a PNG picture", "`twc-env maps import` reads pictures of floor plans"),
    (b"\xff\xd8\xff", "a JPEG picture", "`twc-env maps import` reads pictures of floor plans"),
    (b"GIF8", "a GIF picture", "`twc-env maps import` reads pictures of floor plans"),
    (b"BM", "a BMP picture", "`twc-env maps import` reads pictures of floor plans"),
    (b"P5", "a PGM picture", "`twc-env maps import` reads ROS maps and pictures of floor plans"),
    (b"P6", "a PPM picture", "`twc-env maps import` reads pictures of floor plans"),
    (b"%PDF", "a PDF document", _LASER),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it and give the files in it"),
    (b"Rar!", "a RAR archive", "unpack it and give the files in it"),
    (b"\x28\xb5\x2f\xfd", "a Zstandard file", "unpack it: zstd -d"),
    (b"BZh", "a bzip2 file", "unpack it: bunzip2"),
    (b"\x89HDF", "an HDF5 or MATLAB file", f"its layout is its author's own; {_LASER}"),
    (b"MATLAB 5.0", "a MATLAB file", f"its layout is its author's own; {_LASER}"),
    (b"\x93NUMPY", "a single array of numpy", _ARRAYS),
    (b"\x1f\x8b", "a gzip file", "rename it so that its name ends in .gz"),
    (b"\xfd7zXZ\x00", "an xz file", "rename it so that its name ends in .xz"),
)  # fmt: skip
"""First bytes, what they are of, and what would work."""
_HEAD, _BINARY_HEAD = 4096, 600
"""Bytes that tell a text, and in which binary files have a zero."""
_ROS_MAP = {"image", "resolution", "origin"}
"""Keys of the YAML file of a map_server."""
_UNIT_ERROR = 0.05
"""The quaternion of a pose has a length of 1 to this."""
_READINGS = ((WIFI_COLUMNS, "WiFi readings", "--wifi"), (SIGN_COLUMNS, "sign readings", "--signs"))


def refuse_other_kinds(path: str | Path) -> None:
    """Raise DataError for a file that is no log, of a known kind; others are left to the readers."""
    path = Path(path)
    if path.is_dir():
        refuse_output_of_replay(path)
        raise DataError(
            f"{path} is a folder without a log: name a run folder (frames.npz), a ROS 2 bag (metadata.yaml), or a file"
        )
    head, is_unpacked = first_bytes(path, _HEAD)
    if not head:
        raise DataError(f"{path} is empty; {_LASER}")
    for magic, what, remedy in _MAGIC:
        if head.startswith(magic):
            if is_unpacked and remedy.startswith(_BAG):
                what, remedy = f"{what}, packed", f"unpack it: {_UNPACK[path.suffix]}"
            raise DataError(f"{path} is {what}: {remedy}")
    if zipfile.is_zipfile(path):
        raise DataError(f"{path} is a zip archive: unpack it and give the files in it")
    if head[257:262] == b"ustar":
        raise DataError(f"{path} is a tar archive: unpack it and give the files in it")
    encoding = text_encoding(head)
    if b"\x00" in head[:_BINARY_HEAD] and encoding != "utf-16":
        raise DataError(f"{path} is a binary file of a kind that is not known; {_LASER}")
    if kind := _kind_of_text(head.decode(encoding, "replace"), path):
        raise DataError(f"{path} is {kind}")


def refuse_output_of_replay(folder: Path) -> None:
    """Raise DataError for a folder that `twc-env replay --out` wrote, which holds no log."""
    if (folder / "trajectories").is_dir() and (folder / "table.csv").is_file():
        raise DataError(
            f"{folder} is what a replay wrote, without the log: give the log itself; `twc-env replay LOG --prior "
            f"{folder / 'map.yaml'} --localise` finds robots in the map, `twc-env optimise` reads pose_graph.g2o"
        )


def _kind_of_text(text: str, path: Path) -> str | None:
    """What the beginning of a text is of, and what would work; None if it may be a log."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if {line.split(":")[0] for line in lines} >= _ROS_MAP:
        return (
            f"a ROS map, without scans: `twc-env replay LOG --prior {path} --localise` finds robots in it, and "
            f"`twc-env maps show {path}` draws it"
        )
    first = next((line for line in lines if line[0] not in "#%"), "")
    if first.startswith(("VERTEX", "EDGE")):
        return f"a pose graph (g2o), without scans: `twc-env optimise {path}` reads it"
    if _is_pose(re.split(r"[,\s]+", first)):
        return (
            "a trajectory (TUM), without scans: compare it with trajectories/*.tum of `twc-env replay LOG --out "
            "FOLDER`, as evo_ape does"
        )
    for columns, what, option in _READINGS:
        if any(is_header(line, columns) for line in {*lines[:1], first}):
            return f"a table of {what}, which stands beside a log: `twc-env replay LOG {option} {path}`"
    return None


def _is_pose(words: list[str]) -> bool:
    """Whether a line is of a trajectory: time, position and unit quaternion."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return False
    return len(numbers) == 8 and abs(math.hypot(*numbers[4:]) - 1.0) < _UNIT_ERROR
