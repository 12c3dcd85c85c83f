import json

import pytest

from twc_env.__main__ import main
from twc_env.bench.parts import REST, Stopwatch, bench_parts, table_of
from twc_env.config import EnvConfig
from twc_env.exploration.environment import ExplorationEnv


def test_time_in_a_nested_part_counts_for_that_part():
    now = [0.0]
    watch = Stopwatch(clock=lambda: now[0])

    def work(seconds: float) -> None:
        now[0] += seconds

    inner = watch.timed("inner", lambda: work(2.0))

    def both():
        work(0.5)
        inner()
        inner()

    watch.timed("outer", both)()
    assert watch.time_s == {"inner": 4.0, "outer": 0.5}
    assert watch.calls == {"inner": 2, "outer": 1}


def test_parts_sum_to_the_whole_step_and_functions_are_restored():
    from twc_env.world.world import World

    before = World.tick
    rows = bench_parts(EnvConfig(max_cycles=40), episodes=1)
    assert World.tick is before
    assert sum(row.share for row in rows) == pytest.approx(1.0)
    assert {row.part for row in rows if row.calls_per_step == 1.0} >= {"world: motion and sensors", REST}
    rare = {"team: merging", "team: redrawing", "team: pose graph", "team: verification", "team: merge review"}
    assert {row.part for row in rows if row.calls_per_step == 0.0} <= rare, "a part has another owner now"
    assert [cells[0] for cells in table_of(rows)[-2:]] == ["the engine", "the whole step"]


@pytest.mark.parametrize("setting", ["slam.mode=off", "lidar.beam_count=8"])
def test_the_table_is_printed_with_unusual_settings_and_fits_the_terminal(setting, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("twc_env.commands.bench.terminal_width", lambda: 56)
    path = tmp_path / "new" / "parts.json"
    arguments = ["--parts", "--steps", "40", "--episodes", "1", "--robots", "1", "--json", str(path)]
    assert main(["bench", *arguments, "--set", setting]) == 0
    assert json.loads(path.read_text())["world: motion and sensors"] > 0.0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 56 and sum(line.startswith("the whole step") for line in lines) > 1


def test_objects_used_in_every_step_have_few_attributes():
    """CPython stores up to 29 attributes in the object itself; with more it uses a slower dict."""
    env = ExplorationEnv(robots=2, max_cycles=2)
    env.reset(seed=0)
    used = env, env.episode, env.episode.world, env.engine, env.engine.team, env.engine.team._graph
    assert {type(each).__name__: len(vars(each)) for each in used if len(vars(each)) > 29} == {}
