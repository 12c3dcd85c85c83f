import gc
import tracemalloc

import numpy as np

from twc_env.bench.memory import CHOICES, _played
from twc_env.config import override
from twc_env.tasks import task_config


def test_the_arrays_of_eight_robots_in_a_mall_take_little_memory():
    config = override(task_config("twc/ExploreMall-v1"), CHOICES)
    tracemalloc.start()
    try:
        env = _played(override(config, {"max_cycles": 500}), 1)
        gc.collect()
        arrays = tracemalloc.DomainFilter(True, np.lib.tracemalloc_domain)
        traced = tracemalloc.take_snapshot().filter_traces([arrays]).statistics("filename")
    finally:
        tracemalloc.stop()
    assert env.agents and 10 < sum(row.size for row in traced) / 1e6 < 30
