import numpy as np

from tests.real_data import needs_data
from twc_env.maps import load_map
from twc_env.reproduce.lasting import intel_sessions, sessions
from twc_env.reproduce.lasting.changed_buildings import changed, doorways, fitted, with_fittings
from twc_env.reproduce.lasting.localisation import _longest_s, drifted
from twc_env.world.building.floorplan_check import validate

BUILDING = "validation/0000"


def test_a_gap_of_a_doors_width_between_walls_in_line_is_a_doorway():
    walls = np.array(
        [[[0, 0], [2, 0]], [[3, 0], [5, 0]], [[9, 0], [12, 0]], [[0, 1], [0, 4]], [[0, 4.9], [0, 8]]], float
    )
    assert doorways(walls).tolist() == [[[2, 0], [3, 0]], [[0, 4], [0, 4.9]]]
    crossed = np.concatenate([walls, [[[2.5, -1], [2.5, 1]]]])
    assert doorways(crossed).tolist() == [[[0, 4], [0, 4.9]]]


def test_a_changed_building_is_sound_and_keeps_its_radio():
    plan = load_map(BUILDING)
    before = fitted(plan, 0)
    after = changed(plan, before, 0, 1 / 3, 1 / 2)
    moved = (before.boxes_m != after.boxes_m).any(axis=1)
    assert moved.sum() == round(len(moved) / 3) and after.is_shut.sum() == round(len(after.is_shut) / 2)
    for fittings in (before, after):
        new = validate(with_fittings(plan, fittings))
        assert new.origin == plan.origin and len(new.walls_m) > len(plan.walls_m)


def test_the_same_seed_gives_the_same_furniture():
    plan = load_map(BUILDING)
    assert np.array_equal(fitted(plan, 1).boxes_m, fitted(plan, 1).boxes_m)
    assert not np.array_equal(fitted(plan, 1).boxes_m[:3], fitted(plan, 2).boxes_m[:3])


def test_two_sessions_merge_and_find_what_has_changed(written):
    rows = written("sessions", "--split", "validation", "--buildings", "1", "--sessions", "0", "--jobs", "1")
    building = rows[0]
    assert (building["building"], building["merged"], building["wrong"]) == (BUILDING, 1, 0)
    assert building["ate_m"] < 0.05 and building["grid_change_found"] > 0.9
    assert building["shared_m"] > 20
    assert rows[1]["building"] == "all 1" and rows[1]["merged"] == 1 and rows[1]["apart"] == 0


@needs_data
def test_the_intel_log_goes_on_in_the_map_of_an_earlier_session():
    first, second = intel_sessions.intel_sessions(2, scans=160)
    assert (first["merged"], second["merged"], first["wrong"], second["wrong"]) == (None, 1, 0, 0)
    assert max(first["ate_m"], second["ate_m"]) < 0.15 and second["relation_error_m"] < 0.05
    assert second["file_kb"] > first["file_kb"] > 10


def test_a_table_without_the_intel_log_says_that_it_is_left_out(written, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("TWC_DATA", str(tmp_path))
    assert written("sessions", "--buildings", "0", "--sessions", "0") == []
    assert "three sessions: " in capsys.readouterr().out
    assert "lacks intel_gfs.json.gz, intel_corrected_log.json.gz, intel.rel" in intel_sessions.lacks_log()
    monkeypatch.delenv("TWC_DATA")
    assert "set the environment variable TWC_DATA" in intel_sessions.lacks_log()


def test_what_two_sessions_share_is_the_second_path_near_the_first():
    first = np.column_stack([np.arange(11.0), np.zeros(11)])[:, None]
    second = np.column_stack([np.full(9, 4.0), np.arange(9.0)])[:, None]  # leaves the first path at right angles
    assert sessions._shared_m(first, second) == 1.0
    assert sessions._shared_m(first, second + 20.0) == 0.0


def test_the_error_of_no_pose_is_unknown():
    assert sessions._rms(np.zeros((0, 2))) is None
    assert sessions._rms(np.array([[3.0, 4.0], [0.0, 0.0]])) == np.sqrt(12.5)


def test_the_longest_time_of_being_wrong_is_that_of_one_run():
    times_s = np.array([0.0, 1.0, 1.5, 4.0, 5.0, 9.0])
    assert _longest_s(np.array([1, 1, 0, 1, 1, 1], bool), times_s) == 5.0
    assert _longest_s(np.zeros(6, bool), times_s) == 0.0


def test_odometry_with_errors_is_three_per_cent_longer_and_turns():
    straight = np.column_stack([np.arange(101.0), np.zeros((101, 2))])
    path = drifted(straight, np.random.default_rng(0))
    assert abs(np.hypot(*np.diff(path[:, :2], axis=0).T).sum() - 103) < 1.0
    assert abs(np.degrees(path[-1, 2]) - 50) < 10
