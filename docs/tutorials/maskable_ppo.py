"""MaskablePPO of sb3-contrib on a team: it asks the environments for their action masks by itself.

python docs/tutorials/maskable_ppo.py [DECISIONS] [FOLDER]
"""

import sys
from pathlib import Path

import torch
from sb3 import Returns, TimeIsUp
from sb3_contrib import MaskablePPO
from small_task import SETTINGS, save_curve

from twc_env.vector.sb3 import TeamVecEnv


def main(decisions: int = 8_000, folder: Path = Path("runs/tutorials")) -> None:
    """Learn for this number of decisions of all robots."""
    torch.set_num_threads(1)
    envs = TeamVecEnv(8, SETTINGS, seed=0)
    model = MaskablePPO(
        "MultiInputPolicy",
        TimeIsUp(envs),
        n_steps=32,
        batch_size=64,
        learning_rate=1e-3,
        gamma=1.0,
        ent_coef=0.01,
        seed=0,
    )
    returns = Returns(envs.robots)
    model.learn(decisions, callback=returns)
    save_curve("maskable_ppo", returns.noted, folder)
    envs.close()


if __name__ == "__main__":
    main(*(kind(text) for kind, text in zip((int, Path), sys.argv[1:], strict=False)))
