"""A step that Ctrl-C or SIGTERM cuts off anywhere: what the episode has so far can still be evaluated."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.exploration.assessment import map_scores
from twc_env.exploration.environment import ExplorationEnv
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.slam.engine import CooperativeSlam
from twc_env.world.world import World

PLACES = {
    "after the robots moved": (World, "tick"),
    "after the front ends": (CooperativeSlam, "track"),
    "after the mappers": (CooperativeSlam, "absorb"),
    "before the observations": (ObservationBuilder, "notice"),
    "in the rewards": (map_scores, "standing"),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_cut_off_step_can_be_evaluated(place, monkeypatch):
    owner, name = PLACES[place]
    usual, steps_left = getattr(owner, name), [0]

    def cut_off(*arguments, **options):
        done = usual(*arguments, **options)
        steps_left[0] -= 1
        if steps_left[0] < 0:
            raise KeyboardInterrupt
        return done

    env = ExplorationEnv(
        config=override(EnvConfig(), {"map": "twin-01", "robots": 2, "max_cycles": 60, "reward.period_steps": 1})
    )
    keyframes = []
    for last in range(8, 16):  # robots that drive straight on have a keyframe in some of these
        monkeypatch.setattr(owner, name, usual)
        env.reset(seed=0)
        for _ in range(last):
            env.step({agent: np.array([1.0, 0.0], np.float32) for agent in env.agents})
        steps_left[0] = 0
        monkeypatch.setattr(owner, name, cut_off)
        with pytest.raises(KeyboardInterrupt):
            env.step({agent: np.array([1.0, 0.0], np.float32) for agent in env.agents})
        monkeypatch.setattr(owner, name, usual)
        result = env.result()
        assert len(result.true_poses) == len(result.estimated_poses) == env.episode.steps + 1 == last + 2
        assert np.isfinite(result.estimated_poses).all() and result.figures["steps"] == last + 1
        keyframes += [last + 1 in env.engine.mapper_of(robot).keyframe_steps(robot) for robot in range(2)]
    assert any(keyframes) or place in ("after the robots moved", "after the front ends")
