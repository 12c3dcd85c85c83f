import json

import pytest

from twc_env.__main__ import main
from twc_env.bench_parts import REST, Stopwatch, bench_parts, table_of, time_matching
from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError
from twc_env.exploration.environment import ExplorationEnv


def test_time_spent_inside_another_part_counts_there():
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


def test_the_parts_add_up_to_the_whole_step_and_the_functions_are_put_back():
    from twc_env.world.world import World

    before = World.tick
    rows = bench_parts(EnvConfig(max_cycles=40), episodes=1)
    assert World.tick is before
    assert sum(row.share for row in rows) == pytest.approx(1.0)
    assert {row.part for row in rows if row.calls_per_step == 1.0} >= {"world: motion and sensors", REST}
    rare = {"team: merging", "team: redrawing", "team: pose graph", "team: verification", "team: doubting merges"}
    assert {row.part for row in rows if row.calls_per_step == 0.0} <= rare, "a part has another owner now"
    assert "the engine" in table_of(rows)


def test_matching_is_timed_with_and_without_a_guess():
    figures = time_matching(EnvConfig(), repeats=3)
    assert set(figures) == {"match_600_points_ms", "verify_with_guess_ms", "verify_without_guess_ms"}
    assert 0.0 < figures["match_600_points_ms"] < figures["verify_without_guess_ms"]


def test_matching_needs_keyframes_and_not_a_long_episode():
    assert time_matching(EnvConfig(max_cycles=30), repeats=1)["match_600_points_ms"] > 0.0
    stuck = override(EnvConfig(), {"failure.robots": 3, "failure.robots_step": 1})
    with pytest.raises(ConfigError, match="24 keyframes"):
        time_matching(stuck, repeats=1)


@pytest.mark.parametrize("setting", ["slam.mode=off", "lidar.beam_count=8"])
def test_the_table_is_printed_with_unusual_settings(setting, tmp_path):
    path = tmp_path / "new" / "parts.json"
    arguments = ["--parts", "--steps", "40", "--episodes", "1", "--robots", "1", "--json", str(path)]
    assert main(["bench", *arguments, "--set", setting]) == 0
    assert ("match_600_points_ms" in json.loads(path.read_text())) == (setting != "slam.mode=off")


def test_what_a_step_uses_has_few_attributes():
    """CPython keeps up to 29 with an object itself; of more it makes a dict, through which each is looked up."""
    env = ExplorationEnv(robots=2, max_cycles=2)
    env.reset(seed=0)
    used = env, env.episode, env.episode.world, env.engine, env.engine.team, env.engine.team._graph
    assert {type(each).__name__: len(vars(each)) for each in used if len(vars(each)) > 29} == {}
