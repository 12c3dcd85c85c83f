"""Files that are no logs are told by their content."""

import io
import tarfile
import zipfile

import numpy as np
import pytest

from tests.datasets.test_log_cases import CASES
from twc_env.__main__ import main
from twc_env.datasets.logs.file_kind import refuse_other_kinds
from twc_env.datasets.logs.scan_log import read_any_log
from twc_env.errors import DataError


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.pcap", b"\xd4\xc3\xb2\xa1\x02\x00", "a network capture"),
        ("a.ply", b"ply\nformat ascii 1.0", "a PLY cloud"),
        ("a.las", b"LASF\x00\x00", "a LAS/LAZ cloud"),
        ("a.pcd", b"# .PCD v0.7", "a PCD cloud"),
        ("a.png", b"\x89PNG\r\n", "a PNG picture: `twc-env maps import`"),
        ("a.log", b"\xff\xd8\xff\xe0", "a JPEG picture"),
        ("bag", b"#ROSBAG V2.0\n", r"a ROS 1 bag: rename it so that its name ends in \.bag"),
        ("a.dat", b"\x89MCAP0\r\n", r"ends in \.mcap"),
        ("a.dat", b"SQLite format 3\x00", r"ends in \.db3"),
        ("a.log", b"VERTEX_SE2 0 0 0 0", "a pose graph"),
        ("a.dat", b"x\x00\x01\x02", "a binary file of a kind that is not known"),
        ("a.log", b"", "is empty"),
    ],
)
def test_a_file_of_another_kind_is_told_what_it_is(tmp_path, name, content, told):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=told):
        refuse_other_kinds(tmp_path / name)
    assert main(["replay", str(tmp_path / name)]) == 2


def test_archives_are_to_be_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.log", "w") as archive:
        archive.writestr("a.txt", "x")
    with tarfile.open(tmp_path / "b.log", "w") as archive:
        info = tarfile.TarInfo("a")
        info.size = 1
        archive.addfile(info, io.BytesIO(b"x"))
    for name, what in (("a.log", "zip"), ("b.log", "tar")):
        with pytest.raises(DataError, match=f"a {what} archive: unpack it"):
            refuse_other_kinds(tmp_path / name)


def raw_log(shift_s: float = 0.0) -> str:
    ranges = " ".join(["2.5"] * 10)
    lines = ["PARAM robot_frontlaser_offset 0.2"]
    for k in range(5):
        lines.append(f"ODOM {0.1 * k} 0 0 0 0 0 {10 + k} host {k}")
        lines.append(f"RAWLASER1 0 -0.5 1.0 0.1 20 0.01 0 10 {ranges} 2 7 8 {10.5 + k + shift_s} host {k}")
    return "\n".join(lines)


def test_raw_laser_lines_get_their_poses_from_odometry(tmp_path):
    (tmp_path / "a.log").write_text(raw_log())
    log = read_any_log(tmp_path / "a.log")
    assert log.times_s.tolist() == [10.5, 11.5, 12.5, 13.5]
    assert log.poses[:, 0] == pytest.approx(0.2 + 0.1 * np.array([0.5, 1.5, 2.5, 3.5]))
    assert log.beam_angles_rad == pytest.approx(-0.5 + 0.1 * np.arange(10))


def test_raw_laser_lines_without_odometry_are_refused(tmp_path):
    only = "\n".join(line for line in raw_log().splitlines() if not line.startswith("ODOM"))
    (tmp_path / "a.log").write_text(only)
    with pytest.raises(DataError, match="RAWLASER1 lines but no ODOM lines"):
        read_any_log(tmp_path / "a.log")
    (tmp_path / "b.log").write_text(raw_log(shift_s=1000.0))
    with pytest.raises(DataError, match="no RAWLASER1 line is within the time"):
        read_any_log(tmp_path / "b.log")


def test_lines_with_poses_are_preferred_to_raw_ones(tmp_path):
    flaser = gz_lines(CASES / "08-log-units" / "metres.log.gz")
    (tmp_path / "a.log").write_text(raw_log() + "\n" + flaser)
    assert len(read_any_log(tmp_path / "a.log").times_s) == len(
        read_any_log(CASES / "08-log-units" / "metres.log.gz").times_s
    )


def gz_lines(path) -> str:
    import gzip

    return gzip.decompress(path.read_bytes()).decode()
