import numpy as np
import pytest
from scipy.stats import kstest, norm

from twc_env.world.sensors.noise import NORMALS_PER_WORD, StepNoise, StepQueue, look_up_normals, normal_quantiles


def streams(*seeds):
    return [np.random.default_rng(seed) for seed in seeds]


@pytest.mark.parametrize(("count", "steps"), [(3, 256), (60, 64), (200, 16)])
def test_numbers_in_blocks_equal_those_drawn_step_by_step(count, steps):
    noise = StepNoise(streams(1, 2), count).beside(streams(3, 4), 2, "random")
    normal, uniform = streams(1, 2), streams(3, 4)
    assert "numbers" not in vars(noise), "no memory before the first step"
    for _ in range(150):
        found = noise.next()
        for robot in range(2):
            assert found[robot, :count] == pytest.approx(normal[robot].standard_normal(count), abs=0)
            assert found[robot, count:] == pytest.approx(uniform[robot].random(2), abs=0)
    assert noise.numbers.shape == (steps, 2, count + 2)


@pytest.mark.parametrize("count", [3, 200])
def test_a_queue_gives_each_robot_the_rows_of_its_stream_in_order(count):
    queue, drawn = StepQueue(streams(1, 2), count), streams(1, 2)
    used_by = np.random.default_rng(3).random((300, 2)) < [0.9, 0.3]
    for step, uses in enumerate(used_by):
        queue.hold(step)
        for robot in np.flatnonzero(uses):
            row = queue.numbers[queue.used[robot], robot]
            assert row == pytest.approx(drawn[robot].standard_normal(count), abs=0)
            queue.used[robot] += 1


def test_words_differ_between_steps_and_robots_and_repeat_with_the_seed():
    first, second = StepNoise(streams(1, 2), 4, "bits"), StepNoise(streams(1, 2), 4, "bits")
    seen = set()
    for _ in range(100):
        words = first.next().copy()
        assert np.array_equal(words, second.next())
        seen.update(words.ravel().tolist())
    assert len(seen) == 100 * 2 * 4


def test_the_quantiles_have_the_moments_of_the_normal_distribution():
    quantiles = normal_quantiles(4096)
    assert len(quantiles) == 4096 and (np.diff(quantiles) > 0).all()
    assert quantiles.mean() == pytest.approx(0.0, abs=1e-12)
    assert quantiles.std() == pytest.approx(1.0, abs=1e-12)
    assert (quantiles**4).mean() == pytest.approx(3.0, abs=0.03)
    assert np.mean(np.abs(quantiles) < 1.0) == pytest.approx(0.6827, abs=0.001)
    assert 3.6 < quantiles[-1] < 3.8


def test_numbers_looked_up_are_normal_and_independent():
    count = 40_000
    table, words = normal_quantiles(), np.random.default_rng(5).bit_generator.random_raw(count)
    numbers = np.empty(count * NORMALS_PER_WORD)
    look_up_normals(words, table, numbers)
    assert kstest(numbers, norm.cdf).pvalue > 0.01
    sampling = 4.0 / np.sqrt(len(numbers))
    for power, moment, spread in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):  # variance of z^power
        assert (numbers**power).mean() == pytest.approx(moment, abs=sampling * np.sqrt(spread) + 0.02 * (power == 4))
    for bound in (1.0, 2.0, 3.0, 3.5):
        wanted = 2.0 * norm.sf(bound)
        found = np.mean(np.abs(numbers) > bound)
        assert found == pytest.approx(wanted, abs=sampling * np.sqrt(wanted) + 0.5 / 4096), "to half an entry"
    for lag in (1, 2, NORMALS_PER_WORD, 180):
        assert np.mean(numbers[lag:] * numbers[:-lag]) == pytest.approx(0.0, abs=sampling)
