import numpy as np
import pytest

import twc_env


@pytest.mark.parametrize(("still_s", "expected"), [(0.0, 1), (1.0, 6)])
def test_a_robot_that_stands_takes_a_keyframe_after_the_set_time_or_never(still_s, expected):
    env = twc_env.parallel_env(map="twin-01", robots=1, config={"slam.keyframe.still_s": still_s})
    env.reset(seed=0)
    for _ in range(50):
        env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
    assert len(env.engine.team.keyframes[0]) == expected
