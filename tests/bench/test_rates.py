import gc
import importlib.util
import json
import sys

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.bench import peers as bench_peers
from twc_env.bench import probes as bench_probes
from twc_env.bench import scaling as bench_scaling
from twc_env.bench import vector_teams as bench_vector
from twc_env.bench.gymnasium_teams import GymnasiumTeams
from twc_env.bench.rates import OurRuns, Run
from twc_env.config import EnvConfig
from twc_env.maps import load_map
from twc_env.vector import VectorTeams

TINY = {"REPETITIONS": 2, "EPISODES": 1, "WORLD_STEPS": 12, "SLAM_STEPS": 12}
NUMBERS = {
    "world_env_steps_per_s", "slam_env_steps_per_s", "world_env_steps_per_cpu_s", "slam_env_steps_per_cpu_s",
    "slam_step_p99_ms",
}  # fmt: skip
PROBED = {
    "first_step_warm_s",
    "first_step_cold_s",
    "all_kernels_cold_s",
    "memory_per_env_mb",
    "workers2_speedup",
    "two_cores_ceiling",
}
ROW = {"what": "walls", "value": 206, "walls": 206, "access_points": 20, "us_per_env_step": 61.5}
OF_PEERS = {"irsim_env_steps_per_s", "mpe2_env_steps_per_s", "world_over_irsim", "slam_over_mpe2"}


def test_the_comparison_has_its_keys_whether_peers_are_installed_or_not(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(bench_peers, "is_installed", lambda peer, report: report(f"{peer} is missing"))
    for name, value in {**TINY, "SLAM_MAP": "twin-01"}.items():
        monkeypatch.setattr(bench_peers, name, value)
    monkeypatch.setattr(bench_probes, "probe", lambda *_: dict.fromkeys(PROBED, 1.0))
    monkeypatch.setattr(bench_scaling, "bench_scaling", lambda **_: [ROW])
    monkeypatch.setattr(bench_scaling, "bench_large_reset", lambda: {"large_reset_s": 0.1})
    path = tmp_path / "bench.json"
    assert main(["bench", "--peers", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert set(figures) >= NUMBERS | PROBED | OF_PEERS | {"large_reset_s", "scaling"}
    assert all(figures[key] > 0 for key in NUMBERS)
    assert all(figures[key] is None for key in OF_PEERS)
    assert figures["world_access_points"] == 20 and figures["world_walls"] >= 200
    captured = capsys.readouterr()
    assert "walls  206    206    20             61.5" in captured.out
    assert "irsim is missing" in captured.err and "1/2 world" in captured.err


def test_peers_are_measured_beside_each_episode_and_compared_within_a_repetition(monkeypatch):
    played, slowness = [], iter([1.0] * 3 + [3.0] * 3 + [1.0] * 3)  # of the machine, which slows down for a while
    now = [1.0]

    def candidate(name: str, cpu_s: float):
        def once(seed: int) -> Run:
            played.append((name, seed))
            if name == "world":
                now[0] = next(slowness)
            taken_s = (1 + seed) * cpu_s * now[0]
            return Run(10, 2.0 * taken_s, taken_s, 0.1 * seed, np.full(10, taken_s / 10))

        return once

    names = {"world": 1.0, "slam": 2.0, "irsim": 30.0}
    monkeypatch.setattr(bench_peers, "REPETITIONS", 3)
    monkeypatch.setattr(bench_peers, "EPISODES", 3)
    monkeypatch.setattr(bench_peers, "_candidates", lambda _: {name: candidate(name, s) for name, s in names.items()})
    figures = bench_peers._rates(lambda _: None)
    assert played == [(name, seed) for seed in [0, 1, 2] * 3 for name in names]
    assert figures["world_over_irsim"] == pytest.approx(30.0) and figures["slam_over_irsim"] == pytest.approx(15.0)
    assert figures["slam_over_mpe2"] is None and figures["slam_team_ate_m"] == 0.1
    assert figures["slam_env_steps_per_s"] == pytest.approx(30 / 24) and figures["episodes"] == 3


def test_a_peer_that_is_not_installed_is_named_with_the_command_that_installs_it(monkeypatch):
    lines: list[str] = []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert not bench_peers.is_installed("irsim", lines.append)
    assert "IR-SIM" in lines[0] and "pip install ir-sim" in lines[0] and "twc_env[peers]" in lines[0]


def test_a_peer_that_lacks_a_library_is_left_out_with_its_name(monkeypatch, tmp_path):
    for peer in bench_peers.PEERS:
        (tmp_path / f"{peer}.py").write_text("import imageioo")
        monkeypatch.delitem(sys.modules, peer, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    lines: list[str] = []
    assert set(bench_peers._candidates(lines.append)) == {"world", "slam"}
    assert lines[0] == "IR-SIM cannot be imported, its figures stay empty: No module named 'imageioo'"


@pytest.mark.filterwarnings("ignore")
def test_ir_sim_scans_with_all_beams_of_all_robots_in_every_step():
    pytest.importorskip("irsim", reason="needs the extra 'peers'")
    runs = bench_peers.IrsimRuns(2)
    before = [scan.copy() for scan in runs.scans]
    assert runs.once(0).steps == 2
    for scan, old in zip(runs.scans, before, strict=True):
        assert scan.shape == (bench_peers.BEAMS,)
        assert 0.5 < scan.min() < 10.0, "no box in sight"
        assert not np.array_equal(scan, old)


def test_mpe2_runs_three_agents():
    pytest.importorskip("mpe2", reason="needs the extra 'peers'")
    assert bench_peers.Mpe2Runs(3).once(0).steps == 3


def test_an_episode_is_timed_step_by_step_and_evaluated():
    runs = OurRuns(EnvConfig(robots=2, max_cycles=15), load_map("twin-01"))
    run = runs.once(1)
    assert run.steps == 15 and run.step_s.shape == (15,)
    assert run.step_s.sum() == pytest.approx(run.wall_s, rel=0.05)
    assert 0.0 <= run.team_ate_m < 1.0


def test_cutting_walls_does_not_change_the_building():
    plan = load_map("twin-01")
    cut = bench_scaling.cut_walls(plan, 4)
    assert len(cut.walls_m) == len(cut.wall_loss_db) == 4 * len(plan.walls_m)
    assert np.array_equal(cut.cells().free, plan.cells().free)
    begin, end = plan.walls_m[1]
    assert cut.walls_m[4:8, 0] == pytest.approx(begin + np.arange(4)[:, None] / 4 * (end - begin))


def test_a_row_of_the_scaling_table_is_a_cost(monkeypatch):
    row = bench_scaling._row("beams", 90, load_map("twin-01"), {"lidar.beam_count": 90}, 5)
    assert row["us_per_env_step"] > 0 and row["walls"] == 82


def test_two_workers_run_at_once_and_are_compared_with_one():
    lines: list[str] = []
    bench_probes._ROUNDS, kept = 1, bench_probes._ROUNDS
    try:
        figures = bench_probes.two_workers("twin-01", 4, lines.append)
    finally:
        bench_probes._ROUNDS = kept
    assert set(figures) == {"workers2_speedup", "two_cores_ceiling"}
    assert lines and all(figure is None or 0.05 < figure < 20.0 for figure in figures.values())


def test_vector_teams_with_workers_are_compared_with_none_and_with_gymnasium():
    lines: list[str] = []
    figures = bench_vector.bench_vector(EnvConfig(robots=2, max_cycles=4), (2,), lines.append)
    rows = {row["how"]: row for row in figures["vector"]}
    assert len(rows) == (0 if figures["two_cores_ceiling"] is None else 6) and lines
    for row in rows.values():
        assert 0.0 < row["speedup"] < 20.0 and row["start_s"] > 0.0
    if rows:
        assert rows[bench_vector.NONE]["speedup"] == 1.0
        processes = [row["processes"] for row in rows.values()]
        assert processes == [1, 2, 2, 1, 3, 3]
        assert 1.0 <= figures["lockstep_limit2"] <= 2.0


def test_teams_as_an_environment_of_gymnasium_give_what_vector_teams_give():
    config = EnvConfig(robots=2, max_cycles=2)
    ours, theirs = VectorTeams(2, config), GymnasiumTeams(config, 2)
    assert all(np.array_equal(block, theirs.reset(seed=3)[0][name]) for name, block in ours.reset(3).items())
    for _ in range(3):
        actions = theirs.action_space.sample()
        seen, rewards, ended, infos = ours.step(actions)
        blocks, _, _, _, info = theirs.step(actions)
        assert theirs.observation_space.contains(blocks)
        assert all(np.array_equal(block, blocks[name]) for name, block in seen.items())
        assert np.array_equal(info["rewards"], rewards) and np.array_equal(info["ended"], ended)
        assert info["reward_terms"].shape == (2, 2, len(infos[0][0]["reward_terms"]))
    theirs.close()


def test_a_temporary_slowdown_affects_the_rates_of_one_and_two_workers_equally(monkeypatch):
    seconds = iter([[2.0], [1.0, 2.0], [1.0]] * 2)  # of each task: the first alone, both, the second alone
    monkeypatch.setattr(bench_probes, "_ROUNDS", 1)
    monkeypatch.setattr(bench_probes, "_start", lambda *_: None)
    monkeypatch.setattr(bench_probes, "_end", lambda _: None)
    monkeypatch.setattr(bench_probes.os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    said = iter([[1.0, 1.0], *seconds])
    monkeypatch.setattr(bench_probes, "_answers", lambda _, word: next(said) if word == "go" else [])
    assert bench_probes.two_workers("twin-01", 4, print) == {"workers2_speedup": 2.0, "two_cores_ceiling": 2.0}


def test_a_dead_worker_is_an_error_and_ends_the_other(monkeypatch):
    started = []

    def start(*arguments):
        started.append(bench_probes.subprocess.Popen(["cat"], stdin=-1, stdout=-1, text=True))
        if len(started) == 1:
            started[0].kill()
            started[0].wait()
        return started[-1]

    monkeypatch.setattr(bench_probes, "_start", start)
    monkeypatch.setattr(bench_probes.os, "sched_getaffinity", lambda _: {0, 1})
    with pytest.raises(RuntimeError, match="a worker of the probe came to an end"):
        bench_probes.two_workers("twin-01", 4, print)
    assert all(worker.wait(timeout=10) for worker in started)


def test_bench_rejects_actions_other_than_velocity(capsys):
    assert main(["bench", "--set", "action.kind=waypoint"]) == 2
    assert "needs action.kind = 'velocity'; got 'waypoint'" in capsys.readouterr().err


def test_the_large_building_is_generated_and_reset():
    figures = bench_scaling.bench_large_reset("gen:office:300:1")
    assert set(figures) == {"large_generate_s", "large_first_reset_s", "large_reset_s"}
    assert all(value > 0 for value in figures.values())


def test_a_long_episode_is_timed_by_tenths(tmp_path, capsys):
    path = tmp_path / "long.json"
    assert main(["bench", "--long", "--steps", "100", "--json", str(path)]) == 0
    rows = json.loads(path.read_text())["stretches"]
    assert [row["steps"] for row in rows] == list(range(10, 101, 10))
    assert all(0 < row["median_ms"] <= row["p99_ms"] <= row["worst_ms"] for row in rows)
    for key in ("path_m", "keyframes", "closures"):
        assert [row[key] for row in rows] == sorted(row[key] for row in rows)
    assert rows[-1]["keyframes"] > 0 < rows[-1]["path_m"]
    record_mb = [row["record_mb"] for row in rows]
    assert np.diff(record_mb) == pytest.approx(np.full(9, record_mb[-1] / 10.1), rel=0.02), "as much for each step"
    assert record_mb[-1] < 0.1 < rows[-1]["memory_mb"] and gc.get_freeze_count() == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 11 and lines[0].split()[:2] == ["steps", "path_m"]


def test_bench_memory_tells_what_each_environment_adds(monkeypatch, capsys):
    from twc_env import tasks
    from twc_env.commands import bench

    tiny = {"map": "gen:office:120:train", "robots": 2, "max_cycles": 40, "lidar.beam_count": 60}
    monkeypatch.setitem(tasks.TASKS, "twc/Tiny-v1", tiny)
    monkeypatch.setitem(bench.SUITES, "v1", ("twc/Tiny-v1",))
    assert main(["bench", "--memory"]) == 0
    (_, row) = capsys.readouterr().out.splitlines()
    assert row.split()[0] == "twc/Tiny-v1" and -1.0 < float(row.split()[1]) < 30.0
