"""Training: run folder, resuming, and reproducibility by seed."""

import csv
import json
import math
from dataclasses import replace

import pytest

from twc_env.errors import DataError, MapError
from twc_env.exploration.assessment.rewards import TERMS
from twc_env.running.output_folder import alone_in

pytestmark = pytest.mark.usefixtures("torch")


def metrics_of(folder):
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_short_training_leaves_a_complete_run_folder(run):
    assert {path.name for path in run.iterdir()} == {"config.json", "metrics.csv", "model.safetensors", "tensorboard"}
    record = json.loads((run / "config.json").read_text())
    assert record["settings"]["seed"] == 3
    assert record["environment"]["lidar"]["beam_count"] == 60
    assert len(record["config_digest"]) == 12
    rows = metrics_of(run)
    assert [int(row["decisions"]) for row in rows] == [64, 128]
    assert 2 <= int(rows[-1]["episodes"]) <= 32
    assert math.isfinite(float(rows[-1]["mean_coverage"]))


def test_tensorboard_shows_what_metrics_csv_has_and_every_term_of_the_reward(run):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    curve = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    columns = ["mean_coverage", "return", "coverage", "merged_robots", "wrong_merges", "ate_m", "length"]
    for column in columns:
        shown = [(step, f"{value:.4f}") for step, value in curve[f"episodes/{column}"]]
        assert shown == [(int(row["decisions"]), row[column]) for row in metrics_of(run)]
    assert {tag for tag in curve if tag.startswith("terms/")} == {f"terms/{term}" for term in TERMS}
    assert curve["terms/coverage"][-1][1] == pytest.approx(curve["episodes/return"][-1][1], abs=1e-5)
    assert [step for step, _ in curve["train/value_loss"]] == [64, 128]


def test_the_step_size_decreases_to_zero():
    from twc_env.training.ppo import falling

    assert [falling(1e-3, left) for left in (1.0, 0.25, 0.0, -0.01)] == [1e-3, 2.5e-4, 0.0, 0.0]


def test_a_run_can_be_resumed_with_another_number_of_processes(train, task, settings, tmp_path):
    train(task, settings, 32, tmp_path)
    train(task, replace(settings, workers=1), 64, tmp_path, resume=True)
    assert int(metrics_of(tmp_path)[-1]["decisions"]) == 64


def test_the_same_seed_learns_the_same_weights(train, task, settings, run, weights_of, tmp_path):
    train(task, settings, 128, tmp_path)
    first, second = (weights_of(folder) for folder in (run, tmp_path))
    assert first.keys() == second.keys() and all(first[name].tobytes() == second[name].tobytes() for name in first)


def test_training_resumes_where_it_stopped_and_keeps_the_learning_curve(train, task, settings, tmp_path):
    train(task, settings, 64, tmp_path)
    train(task, settings, 128, tmp_path, resume=True)
    assert [int(row["decisions"]) for row in metrics_of(tmp_path)] == [64, 128]
    episodes = [int(row["episodes"]) for row in metrics_of(tmp_path)]
    assert 0 < episodes[0] < episodes[1]


def test_a_moved_run_folder_keeps_its_curves_when_it_resumes(train, task, settings, tmp_path):
    train(task, settings, 64, tmp_path / "first")
    (tmp_path / "first").rename(tmp_path / "moved")
    before = list((tmp_path / "moved").rglob("events.*"))
    train(task, settings, 128, tmp_path / "moved", resume=True)
    assert not (tmp_path / "first").exists()
    assert len(list((tmp_path / "moved").rglob("events.*"))) == len(before) + 1


def test_a_row_ahead_of_its_model_is_dropped_when_a_killed_training_resumes(train, task, settings, tmp_path):
    train(task, settings, 64, tmp_path)
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write(
            "128,9,0.5,0.5,0.5,2.0,0.0,0.1,3.0,100.0\n160,1"
        )  # killed before the model was saved, and within a line
    train(task, settings, 128, tmp_path, resume=True)
    rows = metrics_of(tmp_path)
    assert [int(row["decisions"]) for row in rows] == [64, 128]
    assert rows[1]["decisions_per_s"] != "100.0"


def test_a_training_killed_at_any_byte_of_the_learning_curve_resumes_with_the_whole_rows(tmp_path):
    from twc_env.training.learning_curve import COLUMNS, rows_until

    rows = [["64", "9", *["0.5000"] * 7, "100.5"], ["128", "12", *["0.5500"] * 7, "99.0"]]
    text = "".join(",".join(row) + "\r\n" for row in (COLUMNS, *rows))
    path = tmp_path / "metrics.csv"
    for length in range(len(text) + 1):
        path.write_bytes(text[:length].encode())
        whole = text[:length].count("\n") - 1
        assert rows_until(128, path) == rows[: max(whole, 0)], length
    assert rows_until(64, path) == rows[:1]
    path.write_bytes(b"\xff\x00" + text.encode())
    assert rows_until(128, path) == rows


def test_resuming_writes_no_settings_and_keeps_the_mean_over_earlier_episodes(train, task, settings, tmp_path):
    train(task, settings, 64, tmp_path)
    config = tmp_path / "config.json"
    before, changed = config.read_bytes(), config.stat()
    train(task, replace(settings, workers=1), 96, tmp_path, resume=True)
    assert config.read_bytes() == before and config.stat().st_mtime_ns == changed.st_mtime_ns
    assert config.stat().st_ino == changed.st_ino
    rows = metrics_of(tmp_path)
    assert math.isfinite(float(rows[1]["mean_coverage"]))


@pytest.mark.parametrize("change", ['{"kindz": 1}', "3", '{"kinds": [], "area_m2": "big"}'])
def test_the_error_of_an_invalid_run_config_names_it(change, tmp_path):
    from twc_env.training.run_folder import read_settings

    (tmp_path / "config.json").write_text(f'{{"task": {change}, "settings": {{}}, "config_digest": ""}}')
    with pytest.raises(DataError, match="holds a task of another form"):
        read_settings(tmp_path)
    (tmp_path / "config.json").write_text("[]")
    with pytest.raises(DataError, match="lacks config_digest"):
        read_settings(tmp_path)


def test_a_wrong_map_leaves_no_run_folder(train, settings, tmp_path):
    from twc_env.training.run_folder import Task

    with pytest.raises(MapError, match="no map named 'twin-3'"):
        train(Task(map="twin-3"), settings, 128, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_resuming_with_another_task_is_rejected(train, settings, run):
    from twc_env.training.run_folder import Task

    with pytest.raises(DataError, match=r"was trained with --map .* instead of twin-02.*; use the same settings"):
        train(Task(map="twin-02"), settings, 512, run, resume=True)


def test_two_trainings_do_not_share_a_folder(train, task, settings, tmp_path):
    (tmp_path / "run").mkdir()
    with (
        alone_in(tmp_path / "run"),
        pytest.raises(DataError, match=r"another command writes to .*run: wait for its end"),
    ):
        train(task, settings, 128, tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())


def test_a_finished_run_is_not_overwritten(train, task, settings, run):
    with pytest.raises(DataError, match="already holds a model; continue with --resume"):
        train(task, settings, 128, run)
