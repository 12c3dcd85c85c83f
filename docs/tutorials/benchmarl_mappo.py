"""MAPPO of BenchMARL on a team: robots share a policy with masked choices, the critic sees what all of them see.

python docs/tutorials/benchmarl_mappo.py [DECISIONS] [FOLDER] [TASK]
"""

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper
from small_task import save_curve, team_of
from torchrl.data import Composite
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

import twc_env

ROLLOUT = 128
"""Steps of the team between two updates."""


class Flat(BaseParallelWrapper):
    """Frontiers and teammates of a robot as one vector, and its mask. The end of the time is the end of the task."""

    def observation_space(self, agent):
        """Two blocks."""
        blocks = super().observation_space(agent)
        numbers = sum(int(np.prod(blocks[name].shape)) for name in ("frontiers", "team"))
        whole = spaces.Box(-np.inf, np.inf, (numbers,), np.float32)
        return spaces.Dict({"observation": whole, "action_mask": blocks["action_mask"]})

    def reset(self, seed=None, options=None):
        """Begin an episode."""
        seen, _ = super().reset(seed=seed, options=options)
        return self._flat(seen), {agent: {} for agent in seen}

    def step(self, actions):
        """One step."""
        seen, paid, terminated, truncated, _ = super().step(actions)
        over = {agent: terminated[agent] or truncated[agent] for agent in seen}
        return self._flat(seen), paid, over, dict.fromkeys(seen, False), {agent: {} for agent in seen}

    def _flat(self, seen):
        return {
            agent: {
                "observation": np.concatenate([blocks["frontiers"].ravel(), blocks["team"].ravel()], dtype=np.float32),
                "action_mask": blocks["action_mask"],
            }
            for agent, blocks in seen.items()
        }


class Exploration(TaskClass):
    """What BenchMARL asks about a task."""

    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        """What makes an environment."""
        team = self.config
        return lambda: PettingZooWrapper(
            Flat(twc_env.parallel_env(**team)), categorical_actions=True, seed=seed, device=device
        )

    def supports_continuous_actions(self):
        """Choices only."""
        return False

    def supports_discrete_actions(self):
        """Frontiers and a few more."""
        return True

    def has_render(self, env):
        """Not here."""
        return False

    def max_steps(self, env):
        """A choice lasts one time step or more."""
        return env.unwrapped.config.max_cycles

    def group_map(self, env):
        """All robots are one group."""
        return env.group_map

    def observation_spec(self, env):
        """What the policy sees."""
        return self._only(env, "observation")

    def action_mask_spec(self, env):
        """Which choices are possible."""
        return self._only(env, "action_mask")

    def info_spec(self, env):
        """Nothing."""
        return None

    def state_spec(self, env):
        """None: the critic gets the observations of all."""
        return None

    def action_spec(self, env):
        """A choice per robot."""
        return env.full_action_spec

    @staticmethod
    def env_name():
        """For BenchMARL's files."""
        return "twc_env"

    def _only(self, env, name):
        group = env.observation_spec["robot"]
        return Composite({"robot": Composite({name: group[name].clone()}, shape=group.shape)})


class Returns(Callback):
    """Notes the return of every episode, of one robot: all are paid the same."""

    def __init__(self):
        super().__init__()
        self.noted, self.gained = [], 0.0

    def on_batch_collected(self, batch):
        """After each rollout, which goes on where the last one ended."""
        after = batch["next"]
        for paid, over in zip(after["robot", "reward"][..., 0, 0].ravel(), after["done"].ravel(), strict=True):
            self.gained += float(paid)
            if over:
                self.noted.append(self.gained)
                self.gained = 0.0


def main(decisions: int = 14_000, folder: Path = Path("runs/tutorials"), task: str | None = None) -> None:
    """Learn for this number of decisions of all robots."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    config = ExperimentConfig.get_from_yaml()
    robots = len(twc_env.parallel_env(**team_of(task)).possible_agents)
    config.max_n_frames = max(decisions // (ROLLOUT * robots), 1) * ROLLOUT
    config.on_policy_collected_frames_per_batch, config.on_policy_n_envs_per_worker = ROLLOUT, 1
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 8, 32
    config.lr, config.gamma, config.clip_grad_val = 1e-3, 1.0, 0.5
    config.evaluation, config.render, config.loggers, config.create_json = False, False, [], False
    algorithm = MappoConfig.get_from_yaml()
    algorithm.entropy_coef, algorithm.lmbda = 0.01, 0.95
    network = MlpConfig(num_cells=[64, 64], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
    returns = Returns()
    with tempfile.TemporaryDirectory() as config.save_folder:  # BenchMARL keeps files of its own
        Experiment(
            task=Exploration("EXPLORE", team_of(task)), algorithm_config=algorithm, model_config=network,
            critic_model_config=network, seed=0, config=config, callbacks=[returns],
        ).run()  # fmt: skip
    save_curve("benchmarl", returns.noted, folder)


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path, str), sys.argv[1:], strict=False)))
