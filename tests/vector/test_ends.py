"""What learners are told about the end of an episode."""

import numpy as np
import pytest


def test_stable_baselines_bootstraps_from_a_time_limit_but_not_from_a_covered_floor():
    sb3 = pytest.importorskip("twc_env.vector.sb3", reason="needs the extra 'train'")
    for share, is_truncated in ((0.2, False), (0.0, True)):
        config = {"map": "gen:office:100:1", "robots": 2, "max_cycles": 60, "episode.ends_at_coverage": share}
        rows = sb3.TeamVecEnv(1, config)
        rows.reset()
        done = np.zeros(2, bool)
        while not done.any():
            _, _, done, infos = rows.step(np.full((2, 2), 0.4, np.float32))
        assert [info["TimeLimit.truncated"] for info in infos] == [is_truncated] * 2
        assert all("terminal_observation" in info and "is_terminated" not in info for info in infos)
        assert (infos[0]["episode"]["l"] == 60) == is_truncated
        rows.close()
