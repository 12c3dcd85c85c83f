"""PPO of TorchRL on a team: one network for all robots, masked choices, one loss for the group "robot".

python docs/tutorials/torchrl_ppo.py [DECISIONS] [FOLDER] [TASK]
"""

import sys
from pathlib import Path

import torch
from small_task import save_curve, team_of
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MaskedCategorical, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

import twc_env
from twc_env.vector.without_infos import WithoutInfos

SEEN = ("robot", "observation")
ROLLOUT = 128
"""Steps of the team between two updates; episodes are cut where they are and go on."""
EPOCHS, BATCH = 8, 32


class Flat(nn.Module):
    """A network on a robot's frontiers and teammates, side by side."""

    def __init__(self, numbers: int, out: int):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(numbers, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, out))

    def forward(self, frontiers: torch.Tensor, team: torch.Tensor) -> torch.Tensor:
        """(..., robots, out)."""
        return self.net(torch.cat([frontiers.flatten(-2), team.flatten(-2)], -1).float())


def main(decisions: int = 14_000, folder: Path = Path("runs/tutorials"), task: str | None = None) -> None:
    """Learn for this number of decisions of all robots; task: a registered one instead of the small one."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    team = twc_env.parallel_env(**team_of(task))
    env = PettingZooWrapper(WithoutInfos(team), categorical_actions=True, seed=0)
    shown = env.observation_spec["robot", "observation"]
    numbers = shown["frontiers"].shape[-2:].numel() + shown["team"].shape[-2:].numel()
    choices = env.observation_spec["robot", "action_mask"].shape[-1]  # the wrapper puts it beside the observation
    blocks = [(*SEEN, "frontiers"), (*SEEN, "team")]
    scorer = TensorDictModule(Flat(numbers, choices), in_keys=blocks, out_keys=[("robot", "logits")])
    mask = TensorDictModule(lambda m: m.bool(), in_keys=[("robot", "action_mask")], out_keys=[("robot", "mask")])
    actor = ProbabilisticActor(
        TensorDictSequential(mask, scorer),
        in_keys={"logits": ("robot", "logits"), "mask": ("robot", "mask")},
        out_keys=[env.action_key],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
        log_prob_key=("robot", "log_prob"),
    )
    critic = TensorDictModule(Flat(numbers, 1), in_keys=blocks, out_keys=[("robot", "state_value")])
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.01, normalize_advantage=True)
    loss.set_keys(
        action=env.action_key, value=("robot", "state_value"), sample_log_prob=("robot", "log_prob"),
        reward=env.reward_key, done=("robot", "done"), terminated=("robot", "done"),
    )  # fmt: skip
    # The end of the time is the end of the task (`terminated` is `done`): what might have come later does not count.
    loss.make_value_estimator(gamma=1.0, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    returns, gained, at = [], 0.0, env.reset()
    for _ in range(max(decisions // (ROLLOUT * len(team.possible_agents)), 1)):
        with torch.no_grad():
            played = env.rollout(ROLLOUT, actor, auto_reset=False, tensordict=at, break_when_any_done=False)
            at = env.step_mdp(played[-1])
            if at["done"].any():
                at = env.reset()
        for paid, over in zip(played["next", "robot", "reward"][:, 0, 0], played["next", "done"][:, 0], strict=True):
            gained += float(paid)
            if over:
                returns.append(gained)
                gained = 0.0
        with torch.no_grad():
            loss.value_estimator(
                played, params=loss.critic_network_params, target_params=loss.target_critic_network_params
            )
        for _ in range(EPOCHS):
            for part in torch.randperm(len(played)).split(BATCH):
                terms = loss(played[part])
                total = terms["loss_objective"] + 0.5 * terms["loss_critic"] + terms["loss_entropy"]
                optimiser.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
    env.close()
    save_curve("torchrl", returns, folder)


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path, str), sys.argv[1:], strict=False)))
