import subprocess
import sys

import numpy as np

from twc_env.records.random_streams import random_stream


def draw(*arguments) -> list[float]:
    return random_stream(*arguments).random(4).tolist()


def test_the_same_name_gives_the_same_numbers():
    assert draw(7, "lidar", 1) == draw(7, "lidar", 1)


def test_seed_source_and_robot_each_select_another_stream():
    streams = [draw(7, "lidar", 0), draw(8, "lidar", 0), draw(7, "odometry", 0), draw(7, "lidar", 1)]
    assert len({tuple(stream) for stream in streams}) == 4


def test_drawing_from_one_stream_does_not_advance_the_others():
    random_stream(3, "radio").random(1000)
    assert draw(3, "odometry") == draw(3, "odometry")


def test_another_process_with_another_hash_seed_draws_the_same_numbers():
    code = "from twc_env.records.random_streams import random_stream as r\n"
    code += "print(r(7, 'lidar', 2).integers(0, 2**62, 3).tolist())"
    outputs = {
        subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True, env={"PYTHONHASHSEED": seed}
        ).stdout.strip()
        for seed in ("1", "2")
    }
    assert outputs == {str(random_stream(7, "lidar", 2).integers(0, 2**62, 3).tolist())}


def test_streams_of_neighbouring_seeds_are_not_correlated():
    first, second = random_stream(0, "lidar").normal(size=20_000), random_stream(1, "lidar").normal(size=20_000)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.03
