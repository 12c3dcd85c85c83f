"""Benchmarks: resuming, summaries and tables."""

import json
import shutil

import numpy as np
import pytest
from twc_env.agents import benchmark

from twc_env import ConfigError, EnvConfig
from twc_env.__main__ import main
from twc_env.config import digest
from twc_env.datasets.logs.arrays_file import write_arrays
from twc_env.maps import bundled_folder
from twc_env.running.options import parse_seeds


def some_report(seed=0, **changes):
    return {
        "robots": 3, "seed": seed, "merged_robots": 3, "wrong_merges": 0, "team_ate_m": 0.09 * (1 + seed),
        "coverage_correct": 0.95, "odometry_ate_m": 2.0, "odometry_coverage_correct": 0.8, "env_steps_per_s": 900.0,
        **changes,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({}, True),
        ({"merged_robots": 2}, False),
        ({"wrong_merges": 1}, False),
        ({"team_ate_m": 0.31}, False),
        ({"team_ate_m": 0.30, "coverage_correct": 0.90}, True),
        ({"coverage_correct": 0.89}, False),
    ],
)
def test_a_seed_passes_only_if_every_criterion_holds(changes, outcome):
    assert benchmark.passes(some_report(**changes)) == outcome


def test_seeds_are_numbers_and_ranges():
    assert parse_seeds("0-3,7, 9-9,2") == (0, 1, 2, 3, 7, 9)
    assert parse_seeds("1,5,7-8") == (1, 5, 7, 8)


@pytest.mark.parametrize("text", ["", "a", "3-1", "-2", "1;2", "²"])
def test_invalid_seeds_are_rejected(text):
    with pytest.raises(ConfigError, match="seeds must be"):
        parse_seeds(text)


@pytest.mark.parametrize("command", ["explore", "benchmark", "compare --buildings 1"])
def test_an_unwritable_folder_is_rejected_before_the_first_episode(command, tmp_path, refusal, monkeypatch):
    monkeypatch.setattr("twc_env.parallel_env", None)
    (tmp_path / "file").write_text("")
    assert "cannot write to the folder" in refusal(main, [*command.split(), "--out", str(tmp_path / "file")])


@pytest.mark.parametrize("arguments", ["benchmark --jobs 0", "compare --buildings 0", "explore --steps 0"])
def test_counts_below_one_are_rejected(arguments, capsys):
    with pytest.raises(SystemExit):
        main(arguments.split())
    assert "must be a whole number of at least 1; got '0'" in capsys.readouterr().err


def test_the_summary_has_mean_standard_deviation_and_extremes():
    summary = benchmark.summary_of([some_report(seed) for seed in range(4)])
    ate = summary["figures"]["team_ate_m"]
    assert ate["mean"] == pytest.approx(0.225)
    assert ate["sd"] == pytest.approx(0.11618950)
    assert (ate["min"], ate["max"]) == pytest.approx((0.09, 0.36))
    assert (summary["passed"], summary["seeds"]) == (3, 4)


def test_the_table_has_a_row_per_seed_and_counts_the_passes():
    lines = benchmark.table_of([some_report(seed) for seed in (2, 0, 3)]).splitlines()
    assert [line.split()[0] for line in lines[2:5]] == ["0", "2", "3"]
    assert lines[2].endswith("yes")
    assert lines[4].endswith("no")
    assert [line.split()[0] for line in lines[6:10]] == ["mean", "sd", "min", "max"]
    assert lines[-1] == "2 of 3 seeds pass"
    assert len({line.index("0.950") for line in lines[2:5]}) == 1


def test_one_seed_has_no_standard_deviation(tmp_path):
    reports = [some_report(0)]
    assert np.isnan(benchmark.summary_of(reports)["figures"]["team_ate_m"]["sd"])
    (spread,) = [line.split() for line in benchmark.table_of(reports).splitlines() if line.split()[:1] == ["sd"]]
    assert set(spread[1:]) == {"-"}
    *_, table = benchmark.write_tables({"a": reports}, {"a": tmp_path}, "random", tmp_path, None)
    assert "(" not in table.read_text() and "nan" not in table.read_text()
    assert json.loads((tmp_path / "summary.json").read_text())["a"]["figures"]["team_ate_m"]["sd"] is None


def test_only_a_finished_run_with_equal_settings_is_reused(tmp_path, capsys):
    arguments = ["benchmark", "--maps", "twin-01", "--seeds", "0-1", "--robots", "2", "--no-pictures"]
    arguments += ["--out", str(tmp_path), "--json", str(tmp_path / "all.json"), "--steps"]
    assert main([*arguments, "30"]) == 0
    report = tmp_path / "twin-01" / "seed-1" / "report.json"
    written = report.stat().st_mtime_ns
    assert "(reused)" not in capsys.readouterr().err
    assert main([*arguments, "30"]) == 0
    assert capsys.readouterr().err.count("(reused)") == 2
    assert report.stat().st_mtime_ns == written
    assert main([*arguments, "31"]) == 0
    assert "(reused)" not in capsys.readouterr().err
    summary = json.loads((tmp_path / "all.json").read_text())
    assert [r["steps"] for r in summary["twin-01"]["reports"]] == [31, 31]
    assert json.loads((tmp_path / "summary.json").read_text()) == summary


def test_a_run_without_requested_pictures_is_run_again(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="pictures need the viz extra")
    arguments = f"benchmark --maps twin-01 --seeds 0 --robots 1 --steps 3 --out {tmp_path}".split()
    picture = tmp_path / "twin-01" / "seed-0" / "map.png"
    assert main([*arguments, "--no-pictures"]) == 0 and not picture.exists()
    assert main(arguments) == 0 and picture.exists()
    assert "(reused)" not in capsys.readouterr().err
    assert main([*arguments, "--no-pictures"]) == 0 and picture.exists()
    assert "(reused)" in capsys.readouterr().err


def test_maps_of_equal_name_in_two_folders_have_separate_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder, name in (("a", "sfw-e1"), ("b", "sfw-e2")):
        (tmp_path / folder).mkdir()
        shutil.copy(bundled_folder() / f"{name}.json", tmp_path / folder / "map.json")
    maps = ["a/map.json", "b/map.json", "sfw-e3", "sfw-e3"]
    assert main(["benchmark", "--maps", *maps, "--seeds", "0", "--steps", "2", "--no-pictures", "--out", "out"]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert {name: [report["map"] for report in of["reports"]] for name, of in summary.items()} == {
        name: [name] for name in maps
    }


def test_a_run_of_other_code_or_another_plan_is_run_again_and_reported(tmp_path, monkeypatch, capsys):
    plan = json.loads((bundled_folder() / "twin-01.json").read_text())
    map_file = tmp_path / "mine.json"
    map_file.write_text(json.dumps(plan))
    arguments = f"benchmark --maps {map_file} --seeds 0 --steps 5 --no-pictures --out {tmp_path / 'out'}".split()
    assert main(arguments) == 0
    assert "run again" not in capsys.readouterr().err
    plan["signs"] = plan["signs"][1:]
    map_file.write_text(json.dumps(plan))
    assert main(arguments) == 0
    assert "1 finished runs used other code or another floor plan" in capsys.readouterr().err
    assert main(arguments) == 0
    assert "(reused)" in capsys.readouterr().err
    monkeypatch.setattr("twc_env.agents.explore.code_digest", lambda *_: "other")
    assert main(arguments) == 0
    assert "1 finished runs used other code or another floor plan" in capsys.readouterr().err


def test_an_unwritable_path_for_json_is_rejected_before_any_episode(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    arguments = ["benchmark", "--json", str(tmp_path / "file" / "a.json"), "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert "cannot write" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_corrupt_report_is_not_reused(tmp_path):
    job = benchmark.Job(EnvConfig(), "random", 0, tmp_path)
    assert benchmark.report_of(job) is None
    (tmp_path / "report.json").write_text("{")
    assert benchmark.report_of(job) is None
    (tmp_path / "report.json").write_text("[]")
    assert benchmark.report_of(job) is None


@pytest.mark.parametrize("change", [{"team_ate_m": None}, {"merged_robots": "3"}, {"robots": 3.0}, {"wall_iou": []}])
def test_a_report_without_a_figure_of_the_tables_is_not_reused(change, tmp_path):
    job = benchmark.Job(EnvConfig(), "random", 0, tmp_path)
    report = some_report(config_digest=digest(job.config), agent="random")
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert benchmark.is_outdated(job)  # of no code
    (tmp_path / "report.json").write_text(json.dumps(report | change))
    assert not benchmark.is_outdated(job)


def test_a_run_whose_record_is_damaged_is_run_again_if_it_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "report_of", lambda job: {"seed": 0})
    monkeypatch.setattr(benchmark, "in_processes", lambda work, jobs, count: [(k, {}) for k in range(len(jobs))])
    write_arrays(tmp_path / "trace.npz", steps=np.arange(3))
    (tmp_path / "map.png").touch()

    def is_reused(pictures: bool) -> bool:
        job = benchmark.Job(EnvConfig(), "random", 0, tmp_path, pictures)
        ((_, _, was_there),) = benchmark.run_jobs([job])
        return was_there

    assert is_reused(True)
    whole = (tmp_path / "trace.npz").read_bytes()
    (tmp_path / "trace.npz").write_bytes(whole[:40] + bytes([whole[40] ^ 1]) + whole[41:])
    assert is_reused(False) and not is_reused(True)


def test_two_processes_give_the_same_reports_as_one(tmp_path):
    config = EnvConfig(map="twin-01", robots=2, max_cycles=15)
    reports = []
    for processes in (1, 2):
        jobs = [benchmark.Job(config, "random", seed, tmp_path / f"{processes}-{seed}", False) for seed in (0, 1)]
        done = {job.seed: report for job, report, _ in benchmark.run_jobs(jobs, processes)}
        for report in done.values():
            del report["env_steps_per_s"], report["agent_s"]
        reports.append(done)
    assert reports[0] == reports[1]


def test_runs_are_listed_by_seed_in_any_order_of_completion(tmp_path):
    command = f"benchmark --maps twin-01 --steps 12 --no-pictures --out {tmp_path}"
    main(f"{command} --seeds 1".split())
    main(f"{command} --seeds 0-2".split())
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [report["seed"] for report in summary["twin-01"]["reports"]] == [0, 1, 2]


def test_an_interrupted_benchmark_still_writes_its_summary(tmp_path, monkeypatch, capsys):
    real, calls = benchmark.run_job, []

    def impatient(job):
        calls.append(job.seed)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(job)

    monkeypatch.setattr(benchmark, "run_job", impatient)
    code = main(f"benchmark --maps twin-01 --seeds 0-2 --steps 12 --no-pictures --out {tmp_path}".split())
    assert code == 130
    assert calls == [0, 1]
    *_, last = capsys.readouterr().err.splitlines()
    assert last == "interrupted after 1 of 3 runs; the same command continues from there"
    assert json.loads((tmp_path / "summary.json").read_text())["twin-01"]["seeds"] == 1
