"""MaskablePPO of sb3-contrib on a team: choices that are not possible are never drawn.

python docs/tutorials/maskable_ppo.py [DECISIONS] [FOLDER]
"""

import sys
from pathlib import Path

import torch
from sb3_contrib import MaskablePPO
from small_task import SETTINGS, save_curve
from stable_baselines3.common.callbacks import BaseCallback

from twc_env.vector.sb3 import TeamVecEnv


class Returns(BaseCallback):
    """Notes the return of every episode, of one robot per team: all robots are paid the same."""

    def __init__(self):
        super().__init__()
        self.noted: list[float] = []

    def _on_step(self) -> bool:
        robots = self.training_env.unwrapped.robots if hasattr(self.training_env, "unwrapped") else 1
        self.noted += [info["episode"]["r"] for info in self.locals["infos"][::robots] if "episode" in info]
        return True


def main(decisions: int = 40_000, folder: Path = Path("runs/tutorials")) -> None:
    """Learn for this number of decisions of all robots."""
    torch.set_num_threads(1)
    envs = TeamVecEnv(8, SETTINGS, seed=0)
    model = MaskablePPO(
        "MultiInputPolicy", envs, n_steps=32, batch_size=128, learning_rate=1e-3, gamma=1.0, ent_coef=0.01, seed=0
    )
    returns = Returns()
    model.learn(decisions, callback=returns)
    save_curve("maskable_ppo", returns.noted, folder)
    envs.close()


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path), sys.argv[1:], strict=False)))
