import numpy as np
import pytest

import twc_env
from agents.careful import CarefulTeam
from agents.policy import make_policy
from twc_env.config import EnvConfig, override


class Ahead:
    """Drives straight on."""

    def reset(self, seed, agents):
        self.seed = seed

    def act(self, beliefs):
        return {agent: np.array([1.0, 0.5], np.float32) for agent in beliefs}

    def finished(self, beliefs):
        return False


@pytest.mark.parametrize("setting", [{"people.count": 3}, {"clutter.furniture": 3}])
def test_our_teams_are_careful_only_where_there_are_people_or_furniture(setting):
    config = override(EnvConfig(), setting)
    assert isinstance(make_policy("nearest-frontier", config), CarefulTeam)
    assert not isinstance(make_policy("nearest-frontier"), CarefulTeam)


def test_a_robot_stops_but_may_turn_while_somebody_walks_towards_it():
    env = twc_env.parallel_env(map="twin-01", robots=1, config={"people.count": 1, "people.walking_share": 1.0})
    env.reset(seed=0)
    team = CarefulTeam(Ahead(), env.config)
    team.reset(0, env.agents)
    crowd, (x, y, heading) = env.episode.world.crowd, env.episode.world.poses_home[0]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    crowd.step = lambda poses, commands: commands
    speeds = []
    for k in range(10):
        crowd._state[0, :2] = np.array([x, y]) + (1.6 - 0.12 * k) * ahead
        crowd.discs[:, :2] = crowd._state[0, :2]
        env.step({agent: np.zeros(2) for agent in env.agents})
        speeds.append(team.act({agent: env.belief(agent) for agent in env.agents})["robot_0"])
    assert speeds[0].tolist() == [1.0, 0.5] and speeds[-1].tolist() == [0.0, 0.5]
