import pytest

from twc_env.bench_parts import REST, Stopwatch, bench_parts, table_of, time_matching
from twc_env.config import EnvConfig


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
