"""PPO of RLlib on a team: one policy for all robots, with masked choices.

python docs/tutorials/rllib_ppo.py [DECISIONS] [FOLDER] [TASK]
"""

import logging
import math
import sys
from pathlib import Path

import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from small_task import save_curve, team_of
from torch import nn

import twc_env

ROLLOUT = 128
"""Steps of the team between two updates."""


class Team(ParallelPettingZooEnv):
    """The team; the end of the time is the end of the task: learners do not add what might have come later."""

    def __init__(self, config):
        super().__init__(twc_env.parallel_env(**config))
        self.agents = self.possible_agents = list(self.par_env.possible_agents)

    def step(self, action_dict):
        """One step."""
        seen, paid, terminated, truncated, infos = super().step(action_dict)
        over = {agent: terminated[agent] or truncated[agent] for agent in truncated}
        return seen, paid, over, dict.fromkeys(truncated, False), infos


class MaskedPolicy(TorchRLModule, ValueFunctionAPI):
    """Logits of the choices, those that are not possible far below, and the value; networks of their own."""

    def setup(self):
        """Two small networks on a robot's frontiers and teammates, side by side."""
        space = self.observation_space
        numbers = math.prod(space["frontiers"].shape) + math.prod(space["team"].shape)
        self.choose, self.value = (
            nn.Sequential(nn.Linear(numbers, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, out))
            for out in (self.action_space.n, 1)
        )

    def _forward(self, batch, **_):
        seen = batch[Columns.OBS]
        logits = self.choose(_flat(seen)).masked_fill(seen["action_mask"] < 1, -1e8)
        return {Columns.ACTION_DIST_INPUTS: logits}

    def compute_values(self, batch, embeddings=None):
        """(batch,)."""
        return self.value(_flat(batch[Columns.OBS])).squeeze(-1)


def _flat(seen):
    return torch.cat([seen["frontiers"].flatten(1), seen["team"].flatten(1)], 1).float()


def main(decisions: int = 14_000, folder: Path = Path("runs/tutorials"), task: str | None = None) -> None:
    """Learn for this number of decisions of all robots."""
    torch.set_num_threads(1)
    ray.init(num_cpus=1, include_dashboard=False, logging_level=logging.ERROR)
    robots = len(twc_env.parallel_env(**team_of(task)).possible_agents)
    returns: list[float] = []
    config = (
        PPOConfig()
        .environment(Team, env_config=team_of(task))
        .env_runners(num_env_runners=0, rollout_fragment_length=ROLLOUT, batch_mode="truncate_episodes")
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda *_, **__: "shared")
        .rl_module(rl_module_spec=RLModuleSpec(module_class=MaskedPolicy))
        .training(
            train_batch_size_per_learner=ROLLOUT, minibatch_size=64, num_epochs=8, lr=1e-3, gamma=1.0, lambda_=0.95,
            entropy_coeff=0.01, use_kl_loss=False, vf_clip_param=float("inf"), grad_clip=0.5,
        )
        .callbacks(on_episode_end=lambda episode, **_: returns.append(episode.get_return() / robots))
        .debugging(seed=0, log_level="ERROR")
    )  # fmt: skip
    algorithm = config.build_algo()
    for _ in range(max(decisions // (ROLLOUT * robots), 1)):
        algorithm.train()
    algorithm.stop()
    ray.shutdown()
    save_curve("rllib", returns, folder)


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path, str), sys.argv[1:], strict=False)))
