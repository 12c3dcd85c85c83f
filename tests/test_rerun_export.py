import json
import shutil

import numpy as np
import pytest

import twc_env
from twc_env.__main__ import main
from twc_env.bench import wander
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.trace import FREE, UNKNOWN, WALL
from twc_env.rerun_export import rectangles, write_rerun

STEPS = 60


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=STEPS, config={"lidar.beam_count": 90})
    env.reset(seed=3)
    trace = twc_env.EpisodeTrace(env, period_s=1.0)
    for actions in wander(env, 3):
        trace.note(env.step(actions)[1])
    trace.write(folder / "trace.npz")
    (folder / "report.json").write_text(json.dumps({**env.result().figures, "agent": "wanderer"}))
    return folder


def test_the_recording_holds_every_step_and_the_figures_of_the_report(run, capsys):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk (extra 'rerun')")
    assert main(["replay", str(run), "--rerun"]) == 0
    assert "replay.rrd" in capsys.readouterr().out
    reader = chunk.RrdReader(str(run / "replay.rrd"))
    assert [entry.application_id for entry in reader.recordings()] == ["twc_env"]
    store = reader.store()
    paths = set(store.schema().entity_paths())
    assert {"/building/walls", "/building/signs", "/team/maps/0", "/team/closures/accepted", "/report"} <= paths
    assert {f"/{who}/robot_{k}/place" for who in ("building", "team") for k in range(2)} <= paths
    summary = store.summary()
    assert f"/building/robot_1/place rows={STEPS + 1} " in summary
    assert "/figures/shares/coverage_correct" in summary


def test_rectangles_cover_each_known_cell_once():
    random = np.random.default_rng(0)
    kinds = random.choice(np.array([UNKNOWN, FREE, WALL], np.uint8), (30, 40), p=[0.2, 0.6, 0.2])
    kinds[10:20, 5:25] = FREE
    boxes, kind = rectangles(kinds)
    painted, times = np.zeros_like(kinds), np.zeros(kinds.shape, int)
    for (first, end, low, high), what in zip(boxes, kind, strict=True):
        painted[low:high, first:end] = what
        times[low:high, first:end] += 1
    assert np.array_equal(painted, kinds)
    assert times.max() == 1
    assert len(rectangles(np.full((50, 50), FREE, np.uint8))[0]) == 1
    assert len(rectangles(np.zeros((5, 5), np.uint8))[0]) == 0


def test_without_rerun_the_error_names_the_extra(run, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"twc_env\[rerun\]"):
        write_rerun(run, tmp_path / "x.rrd")


def test_a_broken_run_or_an_unwritable_place_is_named(run, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk (extra 'rerun')")
    shutil.copy(run / "report.json", tmp_path)
    with pytest.raises(DataError, match=r"trace\.npz"):
        write_rerun(tmp_path, tmp_path / "x.rrd")
    with np.load(run / "trace.npz") as data:
        np.savez(tmp_path / "trace.npz", **{**data, "map_ends": np.zeros(1, np.int64)})
    with pytest.raises(DataError, match="contradicts itself"):
        write_rerun(tmp_path, tmp_path / "x.rrd")
    with pytest.raises(DataError, match="--rerun"):
        write_rerun(run, tmp_path / "report.json" / "x.rrd")
