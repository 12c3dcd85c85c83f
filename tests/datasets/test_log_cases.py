"""Logs and tables of unusual scanners, units and orders, each read right or refused with the remedy."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.config import EnvConfig
from twc_env.datasets.buildings.house_expo import house_expo_plan
from twc_env.datasets.logs import arrays_file, text_file
from twc_env.datasets.logs.arrays_file import read_arrays, write_arrays
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.frame_log import read_frame_log, write_frame_log
from twc_env.datasets.logs.scan_log import beam_count_of, sensor_frames
from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.logs.tum import read_tum
from twc_env.errors import DataError, MapError
from twc_env.records.messages import SensorFrame

CASES = Path(__file__).parent / "cases"


@pytest.mark.parametrize("name", ["millimetres.log.gz", "centimetres.log.gz", "millimetres.json"])
def test_ranges_that_are_not_metres_are_refused(name):
    with pytest.raises(DataError, match=r"beams have a return below 30 m.*ranges must be metres: divide millimetres"):
        read_any_log(CASES / "08-log-units" / name)
    assert len(read_any_log(CASES / "08-log-units" / "metres.log.gz").times_s) > 10


def test_scans_are_put_in_order_of_time(caplog):
    log = read_any_log(CASES / "09-log-time-order" / "swapped.log.gz")
    assert (np.diff(log.times_s) >= 0).all()
    assert "time goes back" in caplog.text
    assert sensor_frames(log, 360, 20.0)[-1].time_s == pytest.approx(log.times_s[-1] - log.times_s[0], abs=0.01)


def test_the_number_of_beams_may_vary_where_their_directions_are_told():
    log = read_any_log(CASES / "10-log-beam-count" / "varying.log.gz")
    assert log.beam_angles_rad.shape == log.ranges_m.shape
    assert (np.isinf(log.ranges_m[:, -1])).any()
    assert len(sensor_frames(log, 360, 20.0)) == len(log.times_s)


def test_directions_may_differ_in_their_last_digits():
    log = read_any_log(CASES / "10-log-beam-count" / "first-angle-jitter.log.gz")
    assert log.beam_angles_rad.ndim == 1


def test_a_scan_of_another_length_is_named():
    with pytest.raises(DataError, match=r"the scan at \S+ has \d+ beams, where the first has \d+"):
        read_any_log(CASES / "10-log-beam-count" / "ragged.json")


def test_the_field_of_view_of_flaser_lines_is_that_of_the_parameters():
    flaser, told = (read_any_log(CASES / "11-flaser-fov" / f"{n}-270.log.gz") for n in ("flaser", "robotlaser"))
    assert np.degrees(flaser.beam_angles_rad[[0, -1]]) == pytest.approx([-135.0, 135.0])
    assert flaser.beam_angles_rad == pytest.approx(told.beam_angles_rad, abs=1e-3)


def test_an_assumed_half_circle_is_said(tmp_path, caplog):
    lines = gzip.decompress((CASES / "11-flaser-fov" / "flaser-270.log.gz").read_bytes()).decode().splitlines()
    (tmp_path / "a.log").write_text("\n".join(line for line in lines if not line.startswith("PARAM")))
    read_any_log(tmp_path / "a.log")
    assert "the 271 beams of a FLASER line are taken for a half circle" in caplog.text


def test_a_coarse_scanner_leaves_no_direction_out():
    log = read_any_log(CASES / "18-log-sparse-lidar" / "two-degrees.log.gz")
    assert beam_count_of([log]) == 180
    assert beam_count_of([read_any_log(CASES / "18-log-sparse-lidar" / "one-degree.log.gz")]) == 360


@pytest.mark.parametrize("settings", [[], ["--set", "lidar.beam_count=180"]])
def test_a_coarse_log_makes_a_map(tmp_path, capsys, settings):
    log = CASES / "18-log-sparse-lidar" / "two-degrees.log.gz"
    assert main(["replay", str(log), *settings, "--out", str(tmp_path)]) == 0
    pixels = np.frombuffer((tmp_path / "map.pgm").read_bytes(), np.uint8)
    assert (pixels == 254).sum() > 2500


def test_a_robot_that_was_put_down_elsewhere_is_found_again_and_it_is_said(tmp_path, capsys):
    """It is lifted after scan 30 and put down 3.1 m away in a room that it has mapped, while odometry reads 0."""
    log = CASES / "13-log-carried" / "carried.log.gz"
    assert main(["replay", str(log), "--out", str(tmp_path)]) == 0
    _, path = read_tum(tmp_path / "trajectories" / "robot_0_estimated.tum")
    assert np.linalg.norm(path[31, :2] - path[30, :2]) == pytest.approx(3.1, abs=0.1)
    told = capsys.readouterr().out
    assert "robot 0 was put down elsewhere at" in told and "in the same map as its path before" in told


@pytest.mark.parametrize(
    ("name", "field"), [("log_tb_frames_94", "step"), ("log_tb_frames_962", "step"), ("log_warn_frames_93", "")]
)
def test_a_column_of_the_wrong_type_is_named(name, field):
    with pytest.raises(DataError, match=f"contradicts itself: {field}.* of type .* numbers are possible"):
        read_frame_log(CASES / "19-malformed" / f"{name}_frames.npz")


@pytest.mark.parametrize("column", ["step", "robot", "time_s", "wifi_count", "sign_frame", "step_frames"])
def test_a_column_of_another_shape_is_named(tmp_path, column):
    frames = [[SensorFrame(0, k, 0.1 * k, np.zeros(3), 0.0, np.ones(180))] for k in range(3)]
    write_frame_log(tmp_path / "frames.npz", EnvConfig(robots=1), frames)
    arrays = dict(np.load(tmp_path / "frames.npz"))
    arrays.pop("checksum", None)
    arrays[column] = arrays[column][:, None]
    np.savez(tmp_path / "frames.npz", **arrays)
    with pytest.raises(DataError, match=rf"contradicts itself: {column} of shape \(\d, 1\), one value a row"):
        read_frame_log(tmp_path / "frames.npz")


def test_a_long_quaternion_is_a_heading():
    _, poses = read_tum(CASES / "19-malformed" / "tum_nan.tum")
    assert np.isfinite(poses).all()


def test_truth_values_are_no_coordinates():
    corners = [[0, 0], [5, 0], [5, 5], [0, True]]
    with pytest.raises(MapError, match="verts must be three or more corners"):
        house_expo_plan({"verts": corners}, "a.json")


@pytest.mark.parametrize("suffix", ["gz", "xz"])
def test_a_packed_text_is_unpacked_up_to_a_limit(tmp_path, monkeypatch, suffix):
    import lzma

    pack = {"gz": gzip.compress, "xz": lzma.compress}[suffix]
    monkeypatch.setattr(text_file, "TEXT_BYTES_MAX", 2_000_000)
    (tmp_path / f"a.log.{suffix}").write_bytes(pack(b" " * 3_000_000))
    with pytest.raises(DataError, match="holds more than 2 MB of text; cut it into parts"):
        read_text(tmp_path / f"a.log.{suffix}")


def test_the_size_of_arrays_is_checked_before_they_are_read(tmp_path, monkeypatch):
    write_arrays(tmp_path / "a.npz", format=np.array("f"), zeros=np.zeros(100_000))
    monkeypatch.setattr(arrays_file, "ARRAYS_BYTES_MAX", 100_000)
    with pytest.raises(DataError, match=r"MB of arrays, .* are possible; record fewer steps"):
        read_arrays(tmp_path / "a.npz", "log", "f", (), "record it again")


def test_arrays_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    write_arrays(path, format=np.array("f"))
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space left"):
        write_arrays(path, format=np.array("g"))
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["a.npz"]
