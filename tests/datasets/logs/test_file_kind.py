"""Files that are no logs are told by their content."""

import gzip
import io
import lzma
import tarfile
import zipfile

import numpy as np
import pytest

from tests.datasets.test_log_cases import CASES
from twc_env.__main__ import main
from twc_env.datasets.logs.arrays_file import write_arrays
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.file_kind import refuse_other_kinds
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


WIFI = b"time,bssid,rssi\n1,aa:bb:cc:dd:ee:01,-50\n"


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("MIT.g2o.gz", b"VERTEX_SE2 0 0 0 0\n", "a pose graph .*`twc-env optimise"),
        ("a.graph", b"# made by hand\n\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n", "a pose graph .*`twc-env optimise"),
        ("robots.bag.gz", b"#ROSBAG V2.0\n", "a ROS 1 bag, packed: unpack it: gunzip"),
        ("robots.mcap.xz", b"\x89MCAP0\r\n", "an MCAP file, as ROS 2 bags are, packed: unpack it: unxz"),
        ("logs.tar.gz", bytes(257) + b"ustar", "a tar archive: unpack it"),
        ("a.dat.gz", b"x\x00\x01", "a binary file of a kind that is not known"),
        (
            "map.yaml", b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n",
            "a ROS map, without scans: `twc-env replay LOG --prior .* --localise` .* `twc-env maps show",
        ),
        ("a.tum", b"# time x y z qx qy qz qw\n0 1 2 0 0 0 0.6 0.8\n", r"a trajectory \(TUM\), without scans: compare"),
        ("wifi.csv", WIFI, "a table of WiFi readings, which stands beside a log: `twc-env replay LOG --wifi"),
        ("wifi.csv.gz", WIFI, "a table of WiFi readings"),
        ("wifi.txt", WIFI.decode().encode("utf-16"), "a table of WiFi readings"),
        ("wide.csv", b"\n# walk\ntime;aa:bb:cc:dd:ee:01\n1;-50\n", "a table of WiFi readings"),
        ("signs.csv", b"# stamp label angle_deg distance\n1 A 4 2\n", "a table of sign readings.* --signs"),
    ],
)  # fmt: skip
def test_what_stands_beside_logs_and_what_is_packed_is_told_with_what_reads_it(tmp_path, capsys, name, content, told):
    pack = {".gz": gzip.compress, ".xz": lzma.compress}.get(name[-3:], bytes)
    (tmp_path / name).write_bytes(pack(content))
    with pytest.raises(DataError, match=told):
        refuse_other_kinds(tmp_path / name)
    assert main(["replay", str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("name", ["a.log", "a.log.gz", "a.log.xz"])
def test_a_log_of_any_encoding_is_no_other_kind(tmp_path, name):
    pack = {".gz": gzip.compress, ".xz": lzma.compress}.get(name[-3:], bytes)
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        (tmp_path / name).write_bytes(pack(("# time of logger, sign, angle, x\n" + raw_log()).encode(encoding)))
        refuse_other_kinds(tmp_path / name)
        assert len(read_any_log(tmp_path / name).times_s) == 4


def test_a_packed_file_without_its_suffix_is_to_be_renamed(tmp_path):
    (tmp_path / "a.log").write_bytes(gzip.compress(b"FLASER"))
    with pytest.raises(DataError, match=r"a gzip file: rename it so that its name ends in \.gz"):
        refuse_other_kinds(tmp_path / "a.log")


@pytest.mark.parametrize(
    ("form", "told"),
    [
        ("lasting-map-1", "it is a saved map; give it by --prior"),
        ("truth-1", "it is the truth of a frame log; give it by --truth"),
        ("frames-2", "a newer version wrote it; update twc_env"),
        ("frames-0", "record it again"),
        ("other-1", "record it again"),
    ],
)
def test_our_own_files_of_another_kind_are_told_with_what_takes_them(tmp_path, refusal, form, told):
    write_arrays(tmp_path / "a.npz", format=np.array(f"twc_env/{form}"))
    said = refusal(main, ["replay", str(tmp_path / "a.npz")])
    assert f"has format 'twc_env/{form}'; expected 'twc_env/frames-1': {told}" in said


def test_the_folder_that_a_replay_wrote_holds_no_log(tmp_path, refusal):
    (tmp_path / "trajectories").mkdir()
    (tmp_path / "table.csv").touch()
    said = refusal(main, ["replay", str(tmp_path)])
    assert "is what a replay wrote, without the log: give the log itself" in said and "map.yaml --localise" in said


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
    return gzip.decompress(path.read_bytes()).decode()
