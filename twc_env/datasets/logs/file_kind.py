"""What a file is that is no log, told by its first bytes, and what would work instead."""

from __future__ import annotations

import zipfile
from pathlib import Path

from twc_env.errors import DataError

_LASER = "a log of 2D scans with odometry is needed: a ROS bag, CARMEN, or frames.npz"
_CLOUD = f"holds 3D points of single scans or of a whole scene, without odometry; {_LASER}"
_DRIVER = f"convert it with the scanner's ROS driver; {_LASER}"
_ARRAYS = "write_frame_log of twc_env.datasets makes a log of arrays (docs/frames.md)"
_BAG = "rename it so that its name ends in"
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
    (b"VERTEX", "a pose graph (g2o)", "a graph has no scans: `twc-env optimise` reads it"),
    (b"EDGE", "a pose graph (g2o)", "a graph has no scans: `twc-env optimise` reads it"),
)  # fmt: skip
"""First bytes, what they are of, and what would work."""


def refuse_other_kinds(path: str | Path) -> None:
    """Raise DataError for a file that is no text log, of a known kind; others are left to the readers."""
    path = Path(path)
    if path.is_dir():
        raise DataError(
            f"{path} is a folder without a log: name a run folder (frames.npz), a ROS 2 bag (metadata.yaml), or a file"
        )
    try:
        with path.open("rb") as file:
            head = file.read(600)
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    if not head:
        raise DataError(f"{path} is empty; {_LASER}")
    for magic, what, remedy in _MAGIC:
        if head.startswith(magic):
            raise DataError(f"{path} is {what}: {remedy}")
    if zipfile.is_zipfile(path):
        raise DataError(f"{path} is a zip archive: unpack it and give the files in it")
    if head[257:262] == b"ustar":
        raise DataError(f"{path} is a tar archive: unpack it and give the files in it")
    if path.suffix not in (".gz", ".xz") and b"\x00" in head:
        raise DataError(f"{path} is a binary file of a kind that is not known; {_LASER}")
