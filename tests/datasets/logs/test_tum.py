"""Trajectories survive the TUM format, and evo reads what we write."""

import gzip

import numpy as np
import pytest

from twc_env.datasets.logs.tum import read_tum, write_tum
from twc_env.errors import DataError


def some_poses(count=50):
    rng = np.random.default_rng(3)
    return np.arange(count) * 0.1, np.column_stack([rng.normal(0, 20, (count, 2)), rng.uniform(-3.1, 3.1, count)])


@pytest.mark.parametrize("name", ["a.tum", "a.tum.gz"])
def test_poses_survive_a_round_trip(tmp_path, name):
    times_s, poses = some_poses()
    write_tum(tmp_path / name, times_s, poses)
    read_times_s, read_poses = read_tum(tmp_path / name)
    assert np.allclose(read_times_s, times_s, atol=1e-6)
    assert np.allclose(read_poses, poses, atol=1e-6)


def test_poses_in_map_coordinates_keep_their_micrometres(tmp_path):
    poses = np.array([[500000.123456, 5412345.654321, 1.0], [500001.5, 5412346.234567, -3.1]])
    write_tum(tmp_path / "path.tum", np.array([0.0, 0.1]), poses)
    assert np.abs(read_tum(tmp_path / "path.tum")[1] - poses).max() < 2e-8


def test_a_gz_name_is_really_packed(tmp_path):
    write_tum(tmp_path / "a.tum.gz", *some_poses())
    assert gzip.decompress((tmp_path / "a.tum.gz").read_bytes()).startswith(b"0 ")


def test_a_quarter_turn_is_the_quaternion_with_two_equal_parts(tmp_path):
    write_tum(tmp_path / "a.tum", [1.5], [[1.0, 2.0, np.pi / 2]])
    values = np.array((tmp_path / "a.tum").read_text().split(), float)
    assert np.allclose(values, [1.5, 1, 2, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_a_quaternion_of_any_length_is_a_rotation(tmp_path):
    (tmp_path / "a.tum").write_text("0 1 2 0 0 0 2 2\n1 1 2 0 0 0 -0.003 0.003\n")
    assert np.allclose(read_tum(tmp_path / "a.tum")[1][:, 2], [np.pi / 2, -np.pi / 2])


def test_comments_empty_lines_and_commas_are_understood(tmp_path):
    (tmp_path / "a.tum").write_text("# time x y z q\n\n0,1,2,3,0,0,0,1\n")
    times_s, poses = read_tum(tmp_path / "a.tum")
    assert times_s.tolist() == [0.0]
    assert poses.tolist() == [[1.0, 2.0, 0.0]]


@pytest.mark.parametrize("line", ["1 2 3", "0 1 2 3 0 0 0 one", "0 1 nan 3 0 0 0 1"])
def test_a_malformed_line_is_named(tmp_path, line):
    (tmp_path / "a.tum").write_text("0 0 0 0 0 0 0 1\n" + line + "\n")
    with pytest.raises(DataError, match="line 2: expected 8 numbers"):
        read_tum(tmp_path / "a.tum")


def test_a_quaternion_of_length_zero_is_refused_with_its_line(tmp_path):
    (tmp_path / "a.tum").write_text("# a path\n0 0 0 0 0 0 0 1\n1 2 3 0 0 0 0 0\n")
    with pytest.raises(DataError, match=r"a\.tum, line 3: the quaternion qx qy qz qw is zero"):
        read_tum(tmp_path / "a.tum")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match="nowhere"):
        read_tum(tmp_path / "nowhere.tum")


def test_times_and_poses_must_be_equally_many(tmp_path):
    with pytest.raises(DataError, match=r"\(2,\) and \(3, 3\)"):
        write_tum(tmp_path / "a.tum", [0.0, 1.0], np.zeros((3, 3)))


def test_evo_reads_the_same_poses(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is a development dependency")
    times_s, poses = some_poses()
    write_tum(tmp_path / "a.tum", times_s, poses)
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert np.allclose(trajectory.positions_xyz[:, :2], poses[:, :2], atol=1e-6)
    assert np.allclose(2 * np.arctan2(trajectory.orientations_quat_wxyz[:, 3], trajectory.orientations_quat_wxyz[:, 0]),
                       poses[:, 2], atol=1e-6)  # fmt: skip


def test_unix_times_keep_their_fractions(tmp_path):
    times_s = np.array([1305031102.1758, 1305031102.2113])
    write_tum(tmp_path / "a.tum", times_s, np.zeros((2, 3)))
    assert np.abs(read_tum(tmp_path / "a.tum")[0] - times_s).max() < 1e-5


def test_what_no_reader_takes_is_not_written(tmp_path):
    with pytest.raises(DataError, match="row 1 is not"):
        write_tum(tmp_path / "path.tum", [0.0, 1.0], [[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    assert not (tmp_path / "path.tum").exists()
