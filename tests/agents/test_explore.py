"""The command `explore`: episode, run folder, and error messages."""

import csv
import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from twc_env.agents import explore as explore_module
from twc_env.agents.picture import Film

from twc_env import DataError
from twc_env.__main__ import main
from twc_env.config import digest, from_dict, override
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.tum import read_tum
from twc_env.exploration.assessment.result_table import text_of
from twc_env.exploration.drawing.episode_map import placed_in_building
from twc_env.running.output_folder import alone_in
from twc_env.tasks import task_config

DOCUMENTED = {
    "map", "agent", "robots", "seed", "steps", "sim_time_s", "coverage_believed", "coverage_true", "coverage_correct",
    "map_iou", "merged_robots", "wrong_merges", "team_ate_m", "per_robot_ate_m", "epe_m", "odometry_ate_m",
    "odometry_coverage_correct", "closures", "bytes_sent", "path_length_m", "collisions", "stuck_share",
    "env_steps_per_s", "agent_s", "config_digest", "version",
}  # fmt: skip


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    code = main(
        f"explore --map twin-01 --robots 2 --steps 60 --seed 4 --out {folder}/run --json {folder}/extra.json".split()
    )
    assert code == 0
    return folder


def test_a_run_folder_contains_all_documented_files(run_folder):
    pytest.importorskip("matplotlib", reason="pictures need the viz extra")
    names = {str(path.relative_to(run_folder / "run")) for path in (run_folder / "run").rglob("*") if path.is_file()}
    assert names >= {
        "report.json", "config.json", "map.png", "twin-01-seed4.gif", "map.pgm", "map.yaml", "pose_graph.g2o",
        "pose_graph.csv",
        "trajectories/robot_0_true.tum", "trajectories/robot_1_estimated.tum", "trajectories/robot_1_odometry.tum",
    }  # fmt: skip


def test_the_report_has_every_documented_key_and_is_valid_json(run_folder):
    text = (run_folder / "run" / "report.json").read_text()
    report = json.loads(text)
    assert set(report) >= DOCUMENTED
    assert "NaN" not in text
    assert "Infinity" not in text
    assert json.loads((run_folder / "extra.json").read_text()) == report


def test_the_config_on_disk_has_the_digest_in_the_report(run_folder):
    config = from_dict(json.loads((run_folder / "run" / "config.json").read_text()))
    assert config.robots == 2
    assert digest(config) == json.loads((run_folder / "run" / "report.json").read_text())["config_digest"]


def test_trajectories_have_one_pose_per_step_and_the_graph_its_keyframes(run_folder):
    times_s, poses = read_tum(run_folder / "run" / "trajectories" / "robot_1_true.tum")
    assert len(poses) == 61
    assert times_s[-1] == pytest.approx(6.0)
    graph = read_pose_graph(run_folder / "run" / "pose_graph.g2o")
    assert len(graph.poses) >= 4
    rows = list(csv.DictReader((run_folder / "run" / "pose_graph.csv").read_text().splitlines()))
    assert [int(row["vertex"]) for row in rows] == graph.vertex_ids.tolist()
    assert {row["robot"] for row in rows} == {"0", "1"} and rows[0]["keyframe"] == "0"
    assert all(float(row["time_s"]) == pytest.approx(int(row["step"]) / 10) for row in rows)


def test_the_picture_is_not_blank(run_folder):
    image_module = pytest.importorskip("PIL.Image", reason="pictures need the viz extra")
    with image_module.open(run_folder / "run" / "map.png") as image:
        colours = np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)
    with image_module.open(run_folder / "run" / "twin-01-seed4.gif") as film:
        frames = film.n_frames
    assert len(colours) > 50
    assert frames >= 10


def test_the_legend_of_the_picture_names_every_mark_once(tmp_path, monkeypatch):
    figure_module = pytest.importorskip("matplotlib.figure", reason="pictures need the viz extra")
    named = []
    legend = figure_module.Figure.legend

    def noted(figure, handles, labels, **options):
        named.extend(labels)
        return legend(figure, handles, labels, **options)

    monkeypatch.setattr(figure_module.Figure, "legend", noted)
    arguments = f"explore --robots 2 --steps 20 --no-film --out {tmp_path}".split()
    assert main(arguments) == 0
    assert len(set(named)) == len(named)
    assert {"true walls", "mapped walls", "access points", "signs", "start", "robot 1"} <= set(named)
    assert "robot 0: true (wide), estimated (thin)" in named


def test_paths_are_drawn_by_the_map_they_are_in_where_each_robot_has_its_own():
    """Robots 1 and 2 share a map in both of their mappers, but only that of robot 1 has robot 0 in it, too."""
    estimated = np.tile([1.0, 0.0, 0.0], (4, 3, 1))
    places = np.array([[5.0, 0.0, 0.0], [0.0, 7.0, np.pi / 2], [9.0, 9.0, np.pi]])  # of the maps of robots 1, 2 and 0
    result = SimpleNamespace(
        estimated_poses=estimated,
        groups=((0, 1, 2), (1, 2), (0,)),
        viewers=((1,), (2,), (0,)),
        pose_building_map=places,
    )
    assert placed_in_building(result)[0, :, :2] == pytest.approx(np.array([[8.0, 9.0], [6.0, 0.0], [0.0, 8.0]]))


def test_a_team_in_several_maps_reports_the_reason(tmp_path, capsys):
    arguments = f"explore --map sfw-e4 --robots 2 --steps 60 --no-pictures --out {tmp_path}".split()
    assert main([*arguments, "--set", "building.sign_share=0", "--set", "radio.wifi=false"]) == 0
    assert "why the robots do not all share one map:\n  " in capsys.readouterr().out
    assert main([*arguments, "--set", "slam.oracle=starts"]) == 0
    assert "why not" not in capsys.readouterr().out


def test_many_rejected_closures_do_not_hide_the_paths(tmp_path, monkeypatch):
    axes_module = pytest.importorskip("matplotlib.axes", reason="pictures need the viz extra")
    from twc_env.exploration.drawing import episode_map

    refused = {"status": "rejected", "target_m": (1.0, 1.0), "source_m": (2.0, 1.0)}
    drawn = []
    monkeypatch.setattr(axes_module.Axes, "add_collection", lambda _, lines: drawn.append(lines))
    figure = pytest.importorskip("matplotlib.figure").Figure()
    for count in (3, 1000):
        episode_map._draw_closures(figure.add_subplot(), SimpleNamespace(closures=[refused] * count))
    few, many = drawn
    assert few.get_alpha() is None and many.get_alpha() == 0.1
    assert many.get_zorder() < 2 < few.get_zorder()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("explore --map twin-1", "did you mean 'twin-01'"),
        ("explore --agent nearest", "did you mean 'nearest-frontier'"),
        ("explore --set action.kind=frontier", "need action.kind = 'velocity'; got 'frontier'"),
        ("explore --set lidar.beam_cout=3", "did you mean 'beam_count'"),
        ("explore --set lidar.beam_count", "--set takes KEY=VALUE"),
        ("explore --set lidar.beam_count=many", "must be a whole number"),
        ("explore --config nowhere.toml", "nowhere.toml"),
        ("explore --config twc/ExploreHart-v0", "did you mean 'twc/ExploreHard-v0'"),
        ("benchmark --maps twin-3 --seeds 0", "twin-0"),
        ("benchmark --seeds 3-1", "seeds must be"),
    ],
)
def test_invalid_input_is_an_error_of_one_line_with_exit_code_two(arguments, message, refusal, tmp_path):
    assert message in refusal(main, [*arguments.split(), "--out", str(tmp_path / "run")])
    assert not (tmp_path / "run").exists()


def test_a_run_folder_is_enough_to_repeat_the_episode(tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    settings = ["--map", "sfw-e4", "--robots", "2", "--steps", "40", "--set", "odometry.drift=2"]
    assert main(["explore", *settings, "--seed", "3", "--no-pictures", "--out", str(first)]) == 0
    assert main(["explore", "--config", str(first), "--seed", "3", "--no-pictures", "--out", str(again)]) == 0
    for name in ("config.json", "frames.npz", "pose_graph.g2o", "map.pgm", "trajectories/robot_1_estimated.tum"):
        assert (first / name).read_bytes() == (again / name).read_bytes(), name


@pytest.mark.parametrize("was_killed", [False, True])
def test_a_run_deletes_the_files_of_an_earlier_run(tmp_path, was_killed):
    arguments = ["explore", "--no-film", "--out", str(tmp_path)]
    assert main([*arguments, "--steps", "12", "--robots", "4"]) == 0
    assert (tmp_path / "map_4.yaml").exists() and (tmp_path / "trajectories/robot_3_true.tum").exists()
    for name in ("notes.txt", "replay.html", "trajectories/mine.tum"):
        (tmp_path / name).write_text("")
    if was_killed:  # while writing: the report is written last
        (tmp_path / "report.json").unlink()
    assert main([*arguments, "--steps", "5", "--robots", "1", "--no-pictures"]) == 0
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {
        "config.json", "frames.npz", "trace.npz", "pose_graph.g2o", "pose_graph.csv", "map.yaml", "map.pgm",
        "report.json", "notes.txt",
        *(f"trajectories/{name}.tum" for name in ("robot_0_true", "robot_0_estimated", "robot_0_odometry", "mine")),
    }  # fmt: skip


def test_a_run_locks_its_folder_while_it_writes(tmp_path, monkeypatch):
    folder, write_files, refused = tmp_path / "run", explore_module._write_files, []

    def write_and_look(*arguments):
        write_files(*arguments)
        with pytest.raises(DataError, match="another command writes to"), alone_in(folder, patience_s=0.1):
            pass
        refused.append(folder)

    monkeypatch.setattr(explore_module, "_write_files", write_and_look)
    assert main(["explore", "--steps", "2", "--robots", "1", "--no-pictures", "--out", str(folder)]) == 0
    assert refused == [folder] and not (folder / ".lock").exists()
    with alone_in(folder, patience_s=0.0):
        pass


def test_a_folder_without_a_report_keeps_its_files(tmp_path):
    (tmp_path / "map_2.yaml").write_text("mine")
    assert main(["explore", "--steps", "3", "--robots", "1", "--no-pictures", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "map_2.yaml").read_text() == "mine"


def test_results_for_the_terminal_are_also_written_to_the_file(tmp_path):
    figures = tmp_path / "all.txt"
    figures.write_text("before\n")
    command = [sys.executable, "-m", "twc_env", "explore", "--steps", "2", "--robots", "1", "--no-pictures"]
    with figures.open("a") as file:
        subprocess.run([*command, "--json", "-", "--out", str(tmp_path / "run")], stdout=file, check=True)
    first, _, rest = figures.read_text().partition("\n")
    assert first == "before" and json.loads(rest)["steps"] == 2


def test_robots_that_fail_at_the_start_give_a_complete_run(tmp_path):
    broken = ["--set", "failure.robots=2", "--set", "failure.robots_step=0"]
    assert main(["explore", "--robots", "2", "--steps", "5", *broken, "--no-film", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "report.json").read_text())["coverage_correct"] == 0.0
    assert (tmp_path / "map.png").exists() and not (tmp_path / "frames.npz").exists()


def test_a_standard_task_can_be_passed_as_config(tmp_path):
    chosen = ["--map", "sfw-e4", "--steps", "5", "--no-pictures", "--out", str(tmp_path)]
    assert main(["explore", "--config", "twc/ExploreHard-v0", *chosen]) == 0
    written = from_dict(json.loads((tmp_path / "config.json").read_text()))
    assert written == override(task_config("twc/ExploreHard-v0"), {"map": "sfw-e4", "max_cycles": 5})


def test_runs_with_different_settings_have_different_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for settings in ([], ["--set", "odometry.drift=2"], ["--config", "twc/ExploreHard-v0"], ["--robots", "2"]):
        assert main(["explore", "--map", "sfw-e4", "--steps", "3", "--no-pictures", *settings]) == 0
    folders = list((tmp_path / "runs").iterdir())
    digests = [json.loads((folder / "report.json").read_text())["config_digest"] for folder in folders]
    assert len(set(digests)) == 4
    assert {folder.name for folder in folders} == {f"sfw-e4-nearest-frontier-seed0-{digest}" for digest in digests}


def test_missing_drawing_libraries_are_reported_before_the_episode(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("twc_env.agents.picture.find_spec", lambda name: None)
    assert main(["explore", "--steps", "5", "--out", str(tmp_path / "run")]) == 2
    assert "pip install 'twc_env[viz]'" in capsys.readouterr().err
    assert main(["explore", "--steps", "5", "--no-pictures", "--out", str(tmp_path / "run")]) == 0
    assert not (tmp_path / "run" / "map.png").exists()


def test_an_interrupted_run_writes_its_results_so_far(monkeypatch, capsys, tmp_path):
    def interrupt(_, done, *__):
        if done == 12:
            raise KeyboardInterrupt

    monkeypatch.setattr("twc_env.commands.explore.Bar.show", interrupt)
    assert main(["explore", "--steps", "50", "--no-pictures", "--out", str(tmp_path / "run")]) == 130
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == 12
    assert "interrupted after 12 steps" in capsys.readouterr().err


def test_the_table_is_aligned_and_shows_a_dash_for_missing_values():
    report = {"steps": 3, "closures": {"accepted": 0, "proposed": 0, "precision": None}, "env_steps_per_s": None}
    report |= {"map": "twin-01", "seed": 1, "robots": 2, "merged_robots": 2, "sim_time_s": 0.3}
    heading, _, *lines = text_of(report).splitlines()
    assert heading == "twin-01, seed 1, 2 robots, 3 steps"
    assert text_of({**report, "robots": 1, "steps": 1}).startswith("twin-01, seed 1, 1 robot, 1 step\n")
    values = [line.index(value) for line, value in ((lines[0], "0.3 s"), (lines[-1], "-"))]
    assert lines[0].startswith("simulated time ") and values[0] == values[1]
    assert any(line.startswith("loop closures") and line.endswith("precision -") for line in lines)
    assert any(line.startswith("environment speed") and line.endswith(" -") for line in lines)


def test_what_several_robots_lacked_alike_is_one_line():
    lacked = ["no signs from robot 0", "no signs from robot 7", "no WiFi from robot 7", "robot 3 not heard since 2.0 s"]
    report = {"map": "twin-01", "seed": 1, "robots": 8, "steps": 3, "merged_robots": 2, "lacked": lacked}
    shown = text_of(report)
    assert "\n  no signs from robots 0, 7\n  no WiFi from robot 7\n  robot 3 not heard since 2.0 s\n" in shown


def test_a_film_of_any_length_has_a_bounded_number_of_evenly_spaced_frames():
    pytest.importorskip("PIL", reason="films need the viz extra")
    film = Film(every=1)
    for step in range(1000):
        if film.wants(step):
            film.add(step, np.full((8, 8, 3), step % 250, np.uint8))
    assert 80 <= len(film._steps) <= 161
    assert len(set(np.diff(film._steps))) == 1


def test_a_film_always_ends_with_the_last_step():
    pytest.importorskip("PIL", reason="films need the viz extra")
    film = Film(every=2)
    for step in (*range(0, 320, 2), 319):
        film.add(step, np.zeros((8, 8, 3), np.uint8))
    assert film._steps == [*range(0, 320, 2), 319]


def test_on_a_terminal_progress_is_one_line_and_an_error_begins_a_new_one(monkeypatch, capsys, tmp_path):
    def run(_config, _agent, _seed, _film, watch, _save):
        watch(60, 0.25)
        raise DataError("no room")

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("twc_env.agents.explore.explore", run)
    assert main(["explore", "--steps", "100", "--no-pictures", "--out", str(tmp_path / "run")]) == 2
    first, second, _ = capsys.readouterr().err.split("\n")
    assert "60/100 steps on twin-01, seed 0, 25.0% in a correctly merged map, 0:01 left at most" in first
    assert second == "error: no room"
