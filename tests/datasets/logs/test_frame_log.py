import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import twc_env
from twc_env.config import override
from twc_env.datasets.logs.frame_log import (
    PER_FRAME,
    PER_READING,
    read_contacts,
    read_frame_log,
    read_truth_log,
    wifi_readings,
    write_frame_log,
    write_truth_log,
)
from twc_env.errors import DataError, TwcError
from twc_env.records.messages import Contacts, SensorFrame, WifiScan


@pytest.fixture(scope="module")
def recorded(wander):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=60)
    env.reset(seed=4)
    steps = [env.frames]
    while env.agents:
        env.step({a: wander(f.ranges_m, f.step, f.robot) for a, f in zip(env.agents, env.frames, strict=True)})
        steps.append(env.frames)
    return env, steps


OTHER_TYPES = {
    "complex": lambda column: np.full(column.shape, 1j),
    "object": lambda column: np.full(column.shape, None),
    "date": lambda column: np.zeros(column.shape, "datetime64[s]"),
    "text": lambda column: np.full(column.shape, "a"),
    "fractions": lambda column: column.astype(float) + 0.5,
}


@pytest.mark.parametrize("kind", OTHER_TYPES)
@pytest.mark.filterwarnings("error")
def test_a_column_of_another_type_is_refused_in_one_line_that_names_it(recorded, tmp_path, kind):
    env, steps = recorded
    log, truth, bad = tmp_path / "frames.npz", tmp_path / "truth.npz", tmp_path / "bad.npz"
    write_frame_log(log, env.config, steps, [Contacts(np.ones((2, 2), bool), np.ones((2, 2), bool))] * len(steps))
    write_truth_log(truth, 4, "twin-01", env.result().true_poses)
    refused = 0
    for path, read in ((log, read_frame_log), (truth, read_truth_log)):
        with np.load(path) as arrays:
            held = dict(arrays)
        for name, column in held.items():
            is_allowed = name == "format" or column.dtype.kind in {"text": "U", "fractions": "fU"}.get(kind, "")
            if is_allowed or not column.size:
                continue
            np.savez(bad, **{**held, name: OTHER_TYPES[kind](column)}, allow_pickle=True)
            with pytest.raises(DataError) as caught:
                read(bad)
            assert "\n" not in str(caught.value), name
            assert name in str(caught.value) or kind == "object"
            refused += 1
    assert refused >= 8


def test_true_poses_that_are_not_finite_are_refused(tmp_path):
    write_truth_log(tmp_path / "truth.npz", 4, "twin-01", np.full((3, 1, 3), np.nan))
    with pytest.raises(DataError, match="true_poses that are not finite"):
        read_truth_log(tmp_path / "truth.npz")


def test_frames_that_are_not_told_apart_by_step_are_refused(recorded, tmp_path):
    env, steps = recorded
    with pytest.raises(DataError, match="of one robot"):
        write_frame_log(tmp_path / "frames.npz", env.config, [frames[0] for frames in steps])


@pytest.mark.parametrize(
    ("settings", "fault"),
    [
        ({"robots": 1}, "config.robots is 1, but there are frames of robots 0, 1"),
        ({"lidar.beam_count": 90}, r"beam_count is 90, but there are scans of shape \(180,\): set it"),
    ],
)
def test_frames_of_another_team_or_scanner_are_not_written(recorded, tmp_path, settings, fault):
    env, steps = recorded
    with pytest.raises(DataError, match=fault):
        write_frame_log(tmp_path / "frames.npz", override(env.config, settings), steps)
    assert not list(tmp_path.iterdir())


def test_a_log_gives_back_every_frame_to_the_bit(recorded, tmp_path):
    env, steps = recorded
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    config, read = read_frame_log(tmp_path / "frames.npz")
    assert config == env.config
    assert [len(frames) for frames in read] == [2] * 61
    for before, after in zip(steps, read, strict=True):
        for a, b in zip(before, after, strict=True):
            assert (a.robot, a.step, a.time_s, a.turn_rate_rad_s) == (b.robot, b.step, b.time_s, b.turn_rate_rad_s)
            assert a.signs == b.signs
            assert np.array_equal(a.odometry, b.odometry) and np.array_equal(a.ranges_m, b.ranges_m)
            assert (a.wifi is None) == (b.wifi is None)
            if a.wifi is not None:
                assert np.array_equal(a.wifi.macs, b.wifi.macs)
                assert np.array_equal(a.wifi.rssi_dbm, b.wifi.rssi_dbm)


def test_ages_of_repeated_readings_survive(tmp_path):
    radio = {"stale_age_max_s": 5.0, "sweep_share": 0.5}
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=10, config={"radio": radio})
    env.reset(seed=1)
    steps = [env.frames]
    while env.agents:
        env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
        steps.append(env.frames)
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    scans = [
        [frames[0].wifi for frames in run if frames[0].wifi]
        for run in (steps, read_frame_log(tmp_path / "frames.npz")[1])
    ]
    assert any(scan.age_s.max(initial=0.0) > 0 for scan in scans[0])
    assert all(np.array_equal(a.age_s, b.age_s) for a, b in zip(*scans, strict=True))


def test_scans_without_ages_among_others_are_new(recorded, tmp_path):
    env, steps = recorded
    frame, scan = steps[0][0], WifiScan(np.array([1, 2]), np.array([-50.0, -60.0]))
    frames = [dataclasses.replace(frame, step=k, wifi=scan) for k in range(3)]
    frames[1] = dataclasses.replace(frames[1], wifi=dataclasses.replace(scan, age_s=np.array([1.0, 2.0])))
    write_frame_log(tmp_path / "frames.npz", env.config, [[one] for one in frames])
    _, read = read_frame_log(tmp_path / "frames.npz")
    assert [one.wifi.age_s.tolist() for (one,) in read] == [[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]


def test_the_engine_finds_on_a_log_what_it_found_in_the_world(recorded, tmp_path):
    env, steps = recorded
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    config, read = read_frame_log(tmp_path / "frames.npz")
    engine = twc_env.CooperativeSlam(config, 2)
    for frames in read:
        engine.update(frames)
    engine.finish()
    for robot, agent in enumerate(env.possible_agents):
        belief = env.belief(agent)
        assert np.array_equal(engine.pose_map_robot(robot), belief.pose_map_robot)
        assert np.array_equal(engine.belief(robot).grid.log_odds, belief.grid.log_odds)


def test_logs_are_written_under_the_name_that_was_asked_for(recorded, tmp_path):
    env, steps = recorded
    write_frame_log(tmp_path / "frames", env.config, steps)
    assert len(read_frame_log(tmp_path / "frames")[1]) == len(steps)
    write_truth_log(tmp_path / "truth", 4, "twin-01", env.result().true_poses)
    assert read_truth_log(tmp_path / "truth")[:2] == (4, "twin-01")


def test_steps_without_frames_keep_their_place_and_their_contacts(recorded, tmp_path):
    env, steps = recorded
    heard = [Contacts(np.full((1, 2), k % 2 == 0), np.full((1, 2), k % 3 == 0)) for k in range(6)]
    write_frame_log(tmp_path / "frames.npz", env.config, [steps[0], (), steps[2], steps[3][:1], (), ()], heard)
    _, read = read_frame_log(tmp_path / "frames.npz")
    assert [[frame.step for frame in frames] for frames in read] == [[0, 0], [], [2, 2], [3], [], []]
    contacts = read_contacts(tmp_path / "frames.npz")
    assert [bool(own.heard[0, 0]) for own in contacts] == [True, False, False, True, False, False]
    with np.load(tmp_path / "frames.npz") as data:
        older = {key: data[key] for key in data.files if not key.startswith(("step_frames", "contacts"))}
    np.savez(tmp_path / "older.npz", **older)
    assert [len(frames) for frames in read_frame_log(tmp_path / "older.npz")[1]] == [2, 2, 1]
    np.savez(tmp_path / "odd.npz", **older, step_frames=np.array([2, 2]))
    with pytest.raises(DataError, match="step_frames counts 4 frames, and there are 5"):
        read_frame_log(tmp_path / "odd.npz")
    with pytest.raises(DataError, match="5 contacts for 6 steps"):
        write_frame_log(tmp_path / "frames.npz", env.config, [steps[0]] * 6, heard[:5])


def test_an_empty_log_is_refused(tmp_path):
    with pytest.raises(DataError, match="no frames to write"):
        write_frame_log(tmp_path / "frames.npz", twc_env.EnvConfig(), [])


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "other"])
def test_a_damaged_log_is_refused_in_one_line(recorded, tmp_path, damage):
    env, steps = recorded
    path = tmp_path / "frames.npz"
    write_frame_log(path, env.config, steps)
    if damage == "missing":
        path.unlink()
    elif damage == "text":
        path.write_text("no numbers here")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:2000])
    else:
        np.savez(path, something=np.zeros(3))
    with pytest.raises(DataError) as error:
        read_frame_log(path)
    assert "\n" not in str(error.value) and "frames.npz" in str(error.value)


@pytest.fixture(scope="module")
def columns(recorded, tmp_path_factory):
    """The content of a log that every test may spoil its own copy of."""
    path = tmp_path_factory.mktemp("log") / "frames.npz"
    in_touch = Contacts(np.ones((1, 2), bool), np.ones((1, 2), bool))
    write_frame_log(path, recorded[0].config, recorded[1][:3], [in_touch] * 3)
    with np.load(path) as data:
        return {key: data[key] for key in data.files}


def test_a_log_without_any_of_its_columns_is_named(columns, tmp_path):
    for missing in set(columns) - {"contacts_tried", "contacts_heard", "step_frames"}:  # older logs have none
        np.savez(tmp_path / "frames.npz", **{key: value for key, value in columns.items() if key != missing})
        with pytest.raises(DataError, match=f"'{missing}|{missing};|format None"):
            read_frame_log(tmp_path / "frames.npz")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": np.zeros(1, np.int32)}, "columns of different length"),
        ({"ranges_m": np.zeros(0)}, "columns of different length"),
        ({"sign_frame": np.zeros(7, np.int64)}, "columns of different length"),
        ({"wifi_macs": np.zeros(1, np.int64)}, "columns of different length"),
        ({"sign_text": np.array("[")}, "contradicts itself"),
        ({"sign_text": np.array(3)}, "contradicts itself"),
        ({"config": np.array("{")}, "contradicts itself"),
        ({"robot": np.array([0, 1, 0, 1, 0, 2_000_000_000], np.int32)}, "robots 0 to 2000000000, 0 to 63 are possible"),
        ({"robot": np.array([0, -1, 0, 1, 0, 1], np.int32)}, "robots -1 to 1"),
        ({"robot": np.full(6, 0.5)}, "robot of type float64"),
        ({"robot": np.full(6, "a")}, "robot of type <U1"),
        ({"wifi_count": np.full(6, "a")}, "wifi_count of type <U1"),
        ({"step_frames": np.array("a")}, "step_frames of type <U1"),
        ({"step_frames": np.zeros(0, int)}, "step_frames counts 0 frames"),
        ({"wifi_count": np.full(6, 99, np.int32)}, "wifi_count counts 594 readings"),
        ({"wifi_count": np.full(6, -2, np.int32)}, "wifi_count"),
        ({"wifi_age_s": np.zeros(1)}, "wifi_age_s"),
        ({"odometry": np.zeros((6, 2))}, "odometry"),
        ({"ranges_m": np.zeros(6)}, "ranges_m"),
        ({"sign_frame": np.array([6]), "sign_place": np.zeros((1, 2)), "sign_text": np.array('["A"]')}, "sign_frame"),
        ({"sign_frame": np.array([-1]), "sign_place": np.zeros((1, 2)), "sign_text": np.array('["A"]')}, "sign_frame"),
        ({"sign_frame": np.array([0]), "sign_place": np.zeros((1, 2)), "sign_text": np.array("[1]")}, "sign_text"),
        (
            {key: np.zeros(0, int) for key in (*PER_FRAME, *PER_READING)} | {"sign_text": np.array("[]")},
            "no frames",
        ),
    ],
)
def test_a_log_that_contradicts_itself_is_refused(columns, tmp_path, changes, message):
    np.savez(tmp_path / "frames.npz", **{**columns, **changes})
    with pytest.raises(DataError, match=message):
        read_frame_log(tmp_path / "frames.npz")


@pytest.mark.parametrize("key", ["contacts_tried", "contacts_heard"])
def test_contacts_that_do_not_fit_the_steps_are_refused(columns, tmp_path, key):
    np.savez(tmp_path / "frames.npz", **{**columns, key: columns[key][:-1]})
    with pytest.raises(DataError, match="contacts"):
        read_contacts(tmp_path / "frames.npz")


def test_any_flipped_byte_is_refused_or_harmless(columns, tmp_path):
    np.savez_compressed(tmp_path / "sound.npz", **columns)
    sound, random = (tmp_path / "sound.npz").read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        broken = bytearray(sound)
        for place in random.integers(0, len(sound), 3).tolist():
            broken[place] ^= int(random.integers(1, 256))
        (tmp_path / "broken.npz").write_bytes(broken)
        try:
            read_frame_log(tmp_path / "broken.npz")
        except TwcError:
            refused += 1
    assert refused > 100


def test_every_array_of_a_log_is_described(tmp_path):
    settings = {"map": "twin-01", "robots": 2, "max_cycles": 3, "radio.stale_age_max_s": 5.0}
    env = twc_env.parallel_env(config=settings)
    env.reset(seed=0)
    write_frame_log(tmp_path / "frames.npz", env.config, [env.frames], [env.contacts])
    write_truth_log(tmp_path / "truth.npz", 0, "twin-01", env.result().true_poses)
    text = (Path(__file__).parents[3] / "docs" / "frames.md").read_text(encoding="utf-8")
    first_cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    described = {name for cell in first_cells for name in re.findall(r"`(\w+)`", cell)}
    for name in ("frames.npz", "truth.npz"):
        with np.load(tmp_path / name) as log:
            assert set(log.files) <= described, name


def test_wifi_scans_are_a_table_of_frames_and_addresses(recorded):
    _, steps = recorded
    at, macs, rssi_dbm = wifi_readings(steps, robot=1)
    own = [frames[1] for frames in steps]
    assert at.tolist() == [k for k, frame in enumerate(own) if frame.wifi is not None]
    assert np.all(np.diff(macs) > 0) and rssi_dbm.shape == (len(at), len(macs))
    for k, row in zip(at, rssi_dbm, strict=True):
        assert np.array_equal(macs[np.isfinite(row)], own[k].wifi.macs)
        assert np.array_equal(row[np.isfinite(row)], own[k].wifi.rssi_dbm)
    assert [len(part) for part in wifi_readings(steps, robot=7)] == [0, 0, 0]


def test_readings_repeated_from_an_earlier_scan_are_not_taken_for_readings_at_the_later_place():
    def heard(step, macs, ages_s):
        scan = WifiScan(np.array(macs), -50.0 - np.arange(len(macs)) - step, np.array(ages_s))
        return (SensorFrame(0, step, 100.0 + 2.0 * step, np.zeros(3), 0.0, np.ones(8), scan),)

    steps = [heard(0, [4, 7], [0.3, 0.6]), heard(1, [4, 7], [0.0, 2.6]), heard(2, [4, 7, 9], [2.0, 1.9, 0.0])]
    at, macs, rssi_dbm = wifi_readings(steps)
    assert at.tolist() == [0, 1, 2] and macs.tolist() == [4, 7, 9]
    nan = np.nan
    assert np.array_equal(rssi_dbm, [[-50.0, -51.0, nan], [-51.0, nan, nan], [nan, -53.0, -54.0]], equal_nan=True)
