"""MAPPO by TorchRL on a registered task: how to use its own parts (extra `torchrl`).

    python training/torchrl_mappo.py --task ExploreQuick-v1 --iterations 3

Robots share one policy; the critic sees the observations of all. As in TorchRL's tutorial, a step of the environment is
one decision of every robot: that of a busy one, which can only continue, has one choice. `training/mappo.py` counts
durations instead, and is what docs/learning.md reports.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from twc_env.training.run_folder import Task, task_id

import twc_env
from twc_env.vector.without_infos import WithoutInfos

GROUP = "robot"
BLOCKS = ("frontiers", "gains", "pose", "team")
STEPS, EPOCHS, WIDTH = 64, 4, 64
"""Of the environment per iteration; passes over them; width of the networks."""


class Flat(nn.Module):
    """Some blocks of all robots as one vector each."""

    def forward(self, *blocks: Tensor) -> Tensor:
        """(..., robots, numbers), distances compressed."""
        flat = [block.flatten(block.dim() - (block.dim() - blocks[1].dim() + 1)) for block in blocks]
        joined = torch.cat(flat, -1)
        return torch.sign(joined) * torch.log1p(joined.abs())


def networks(env: Any, robots: int) -> tuple[ProbabilisticActor, TensorDictSequential]:
    """The shared policy and the centralised critic."""
    keys = [(GROUP, "observation", name) for name in BLOCKS]
    seen = env.observation_spec[GROUP, "observation"]
    numbers = sum(seen[name].shape[1:].numel() for name in BLOCKS)
    choices = env.full_action_spec[env.action_key].space.n

    def net(outputs: int, centralised: bool) -> MultiAgentMLP:
        return MultiAgentMLP(
            numbers, outputs, robots, centralized=centralised, share_params=True, depth=2, num_cells=WIDTH
        )

    flat = TensorDictModule(Flat(), in_keys=keys, out_keys=[(GROUP, "flat")])
    score = TensorDictModule(net(choices, False), in_keys=[(GROUP, "flat")], out_keys=[(GROUP, "logits")])
    actor = ProbabilisticActor(
        TensorDictSequential(flat, score),
        spec=env.action_spec,
        in_keys={"logits": (GROUP, "logits"), "mask": (GROUP, "action_mask")},
        out_keys=[env.action_key],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
        log_prob_key=(GROUP, "log_prob"),
    )
    worth = TensorDictModule(net(1, True), in_keys=[(GROUP, "flat")], out_keys=[(GROUP, "state_value")])
    return actor, TensorDictSequential(flat, worth)


def train(task: Task, iterations: int, seed: int = 0) -> list[float]:
    """Train for some iterations; returns the mean reward per step of each."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    team = twc_env.parallel_env(config=task.config)
    env = PettingZooWrapper(WithoutInfos(team), categorical_actions=True)
    env.set_seed(seed)
    actor, critic = networks(env, team.config.robots)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.005, normalize_advantage=True)
    loss.set_keys(
        reward=(GROUP, "reward"), action=env.action_key, value=(GROUP, "state_value"), done=(GROUP, "done"),
        terminated=(GROUP, "terminated"), advantage=(GROUP, "advantage"), value_target=(GROUP, "value_target"),
        sample_log_prob=(GROUP, "log_prob"),
    )  # fmt: skip
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    advantage.set_keys(
        reward=(GROUP, "reward"), value=(GROUP, "state_value"), done=(GROUP, "done"),
        terminated=(GROUP, "terminated"), advantage=(GROUP, "advantage"), value_target=(GROUP, "value_target"),
    )  # fmt: skip
    optimizer = torch.optim.Adam(loss.parameters(), lr=7e-4)
    earned = []
    for _ in range(iterations):
        with torch.no_grad():
            played = env.rollout(STEPS, actor, break_when_any_done=False)
            advantage(played)
        earned.append(float(played["next", GROUP, "reward"].mean()))
        for _ in range(EPOCHS):
            losses = loss(played)
            optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).mean().backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimizer.step()
    env.close()
    return earned


def main(arguments: list[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description="Train MAPPO with TorchRL for a few iterations.")
    parser.add_argument("--task", default="ExploreQuick-v1", help="a registered task")
    parser.add_argument("--iterations", type=int, default=3)
    options = parser.parse_args(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        earned = train(Task(task_id(options.task)), options.iterations)
    for number, mean in enumerate(earned):
        print(f"iteration {number}: mean reward per step {mean:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
