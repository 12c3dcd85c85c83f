import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.surveys.indoor20 import read_indoor20
from twc_env.datasets.surveys.step_heading import dead_reckoning, headings_rad, read_walks, steps
from twc_env.errors import DataError


def test_each_swing_is_a_step_and_harder_ones_are_longer():
    time_s = np.arange(0, 10, 0.02)
    for size in (2.0, 4.0):
        swing = size * np.sin(2 * np.pi * 1.8 * time_s)
        at, length = steps(time_s, np.column_stack([np.zeros_like(swing), np.zeros_like(swing), 9.81 + swing]))
        assert len(at) == pytest.approx(18, abs=1)
        assert np.median(np.diff(at)) == pytest.approx(1 / 1.8, abs=0.03)
        assert length.mean() == pytest.approx(0.38 * (2 * size * 0.95) ** 0.25, rel=0.06)
    assert len(steps(time_s, np.tile([0.0, 0.0, 9.81], (len(time_s), 1)))[0]) == 0


def test_a_phone_that_lies_flat_points_where_it_is_turned_to():
    turns = np.array([0.0, np.pi / 2, -np.pi / 4])
    vectors = np.column_stack([np.zeros(3), np.zeros(3), np.sin(turns / 2)])
    assert headings_rad(vectors) == pytest.approx(np.pi / 2 + turns)  # unturned, the upper edge points north


def test_steps_and_headings_make_a_path():
    at = np.arange(1.0, 9.0)
    poses, turned = dead_reckoning(
        at, np.ones(8), np.array([0.0, 4.4, 4.5, 9.0]), np.array([0, 0, 1, 1]) * np.pi / 2, at
    )
    assert poses[3, :2] == pytest.approx([4.0, 0.0]) and poses[-1, :2] == pytest.approx([4.0, 4.0])
    assert turned.sum() == pytest.approx(np.pi / 2)


@needs_data
def test_dead_reckoning_of_real_walks_is_near_the_survey():
    walks = read_walks(DATA / "indoor20" / "site2_F6", traces_max=6)
    reckoned, surveyed = (
        sum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum() for path in paths)
        for paths in ([w.reckoned for w in walks], [w.surveyed_m for w in walks])
    )
    assert reckoned == pytest.approx(surveyed, rel=0.25)
    assert all(len(w.fingerprints) == len(w.reckoned) == len(w.surveyed_m) for w in walks)


SOUND = {
    "WAYPOINT": "{t}\tTYPE_WAYPOINT\t{k}\t1.0",
    "ACCELEROMETER": "{t}\tTYPE_ACCELEROMETER\t0.0\t0.0\t9.81",
    "ROTATION_VECTOR": "{t}\tTYPE_ROTATION_VECTOR\t0.0\t0.0\t0.1",
    "WIFI": "{t}\tTYPE_WIFI\tname\t02:00:00:00:00:01\t-50\t2412\t{t}",
}


def write_trace(folder, **changes):
    (folder / "traces").mkdir()
    lines = [line.format(t=1000 + 20 * k, k=k) for k in range(60) for line in (SOUND | changes).values()]
    (folder / "traces" / "a.txt").write_text("\n".join(lines))


def test_a_walker_who_takes_no_step_stays_where_it_is(tmp_path):
    write_trace(tmp_path)
    (walk,) = read_walks(tmp_path)
    assert np.abs(walk.reckoned[:, :2]).max() == 0.0 and len(walk.turned_rad) == len(walk.time_s) - 1


@pytest.mark.parametrize(
    "changes",
    [
        {"WAYPOINT": "{t}\tTYPE_WAYPOINT\t{k}"},
        {"ROTATION_VECTOR": "{t}\tTYPE_ROTATION_VECTOR\t0.0\t0.0"},
        {"ACCELEROMETER": "{t}\tTYPE_ACCELEROMETER\t0.0\tup\t9.81"},
        {"ACCELEROMETER": "1000\tTYPE_ACCELEROMETER\t0.0\t0.0\t9.81"},
        {"WIFI": "{t}\tTYPE_WIFI\tname\t02:00:00:00:00:01\t-50"},
        {"WIFI": "{t}\tTYPE_WIFI\tname\t02:00:00:00:00:01:02:03:04\t-50\t2412\t{t}"},
    ],
)
def test_a_trace_that_is_cut_off_in_its_lines_is_a_data_error(tmp_path, changes):
    write_trace(tmp_path, **changes)
    with pytest.raises(DataError):
        read_walks(tmp_path)


def test_a_folder_without_traces_is_told(tmp_path):
    with pytest.raises(DataError, match="no trace"):
        read_walks(tmp_path)


@pytest.mark.parametrize("read", [read_walks, read_indoor20])
def test_a_folder_without_traces_is_refused_with_the_pattern_of_their_names(tmp_path, read):
    with pytest.raises(DataError, match=r"holds no traces/\*\.txt\.xz; check the path"):
        read(tmp_path / "site1_B1")
