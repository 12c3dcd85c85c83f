"""PPO in one file, in the style of cleanrl: nothing is hidden in a library but tensors and their gradients.

python docs/tutorials/one_file.py [DECISIONS] [FOLDER]
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from small_task import SETTINGS, save_curve
from torch import nn
from torch.distributions import Categorical

from twc_env.vector import VectorTeams


@dataclass(frozen=True)
class Settings:
    """Hyperparameters."""

    environments: int = 8
    rollout: int = 16
    """Steps of every environment between two updates."""
    epochs: int = 8
    batch: int = 64
    learning_rate: float = 2e-3
    discount: float = 0.9
    trace: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    entropy: float = 0.01
    seed: int = 0


class Scorer(nn.Module):
    """Scores each frontier with the same small network, the other choices with another; and the value of it all."""

    def __init__(self, slots: int, figures: int, choices: int, others: int, width: int = 64):
        super().__init__()
        self.frontier = nn.Sequential(nn.Linear(figures + others, width), nn.Tanh(), nn.Linear(width, 1))
        whole = slots * figures + others
        self.rest = nn.Sequential(nn.Linear(whole, width), nn.Tanh(), nn.Linear(width, choices - slots))
        self.value = nn.Sequential(nn.Linear(whole, width), nn.Tanh(), nn.Linear(width, 1))

    def forward(self, seen: dict[str, torch.Tensor]) -> tuple[Categorical, torch.Tensor]:
        """Distribution of choices and value, of a batch of robots."""
        rows, team = seen["frontiers"], seen["team"].flatten(1)
        beside = team[:, None].expand(-1, rows.shape[1], -1)
        whole = torch.cat([rows.flatten(1), team], 1)
        logits = torch.cat([self.frontier(torch.cat([rows, beside], 2)).squeeze(2), self.rest(whole)], 1)
        return Categorical(logits=logits.masked_fill(seen["action_mask"] < 1, -1e8)), self.value(whole).squeeze(1)


def robots_of(observations: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    """Blocks with one row per robot of all environments, instead of (environments, robots, ...)."""
    return {
        key: torch.as_tensor(block.reshape(-1, *block.shape[2:]).copy()).float() for key, block in observations.items()
    }


def main(decisions: int = 12_000, folder: Path = Path("runs/tutorials"), s: Settings = Settings()) -> None:
    """Learn for this number of decisions of all robots."""
    torch.set_num_threads(1)
    torch.manual_seed(s.seed)
    teams = VectorTeams(s.environments, SETTINGS)
    seen = robots_of(teams.reset(seed=s.seed))
    (_, slots, figures), choices = seen["frontiers"].shape, seen["action_mask"].shape[1]
    policy = Scorer(slots, figures, choices, seen["team"].flatten(1).shape[1])
    optimiser = torch.optim.Adam(policy.parameters(), lr=s.learning_rate)
    rows = s.environments * teams.robots
    returns, gained = [], np.zeros(s.environments)
    for _ in range(max(decisions // (rows * s.rollout), 1)):
        kept: list[tuple] = []
        for _ in range(s.rollout):  # play
            with torch.no_grad():
                choice, value = policy(seen)
                action = choice.sample()
            observations, rewards, ended, infos = teams.step(action.numpy().reshape(s.environments, teams.robots))
            paid = torch.as_tensor(rewards.reshape(-1).copy()).float()
            gained += rewards[:, 0]
            for k in np.flatnonzero(ended):  # time is up, but the world goes on: what would have come counts too
                returns.append(float(gained[k]))
                gained[k] = 0.0
                last = [info["final_observation"] for info in infos[k]]
                last_seen = {key: torch.as_tensor(np.stack([o[key] for o in last])).float() for key in last[0]}
                with torch.no_grad():
                    paid[k * teams.robots : (k + 1) * teams.robots] += s.discount * policy(last_seen)[1]
            over = torch.as_tensor(np.repeat(ended, teams.robots)).float()
            kept.append((seen, action, choice.log_prob(action), value, paid, over))
            seen = robots_of(observations)
        with torch.no_grad():
            following = policy(seen)[1]
        advantage, advantages = torch.zeros(rows), []
        for _, _, _, value, paid, over in reversed(kept):  # how much better than expected was each choice?
            surprise = paid + s.discount * (1 - over) * following - value
            advantage = surprise + s.discount * s.trace * (1 - over) * advantage
            advantages.append(advantage)
            following = value
        gain = torch.cat(advantages[::-1])
        played = {key: torch.cat([step[0][key] for step in kept]) for key in seen}
        action, before, value = (torch.cat([step[k] for step in kept]) for k in (1, 2, 3))
        worth = gain + value
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        for _ in range(s.epochs):  # make better choices likelier, by a little
            for part in torch.randperm(len(gain)).split(s.batch):
                choice, value = policy({key: block[part] for key, block in played.items()})
                ratio = (choice.log_prob(action[part]) - before[part]).exp()
                clipped = torch.minimum(ratio * gain[part], ratio.clamp(1 - s.clip, 1 + s.clip) * gain[part])
                loss = (
                    -clipped.mean() + 0.5 * (value - worth[part]).square().mean() - s.entropy * choice.entropy().mean()
                )
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
                optimiser.step()
    teams.close()
    save_curve("one_file", returns, folder, parts=20)


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path), sys.argv[1:], strict=False)))
