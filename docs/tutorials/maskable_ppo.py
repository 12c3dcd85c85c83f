"""MaskablePPO of sb3-contrib on a team: it asks the environments for their action masks by itself.

python docs/tutorials/maskable_ppo.py [DECISIONS] [FOLDER]
"""

import sys
from pathlib import Path

import torch
from sb3_contrib import MaskablePPO
from small_task import SETTINGS, save_curve
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from twc_env.vector.sb3 import TeamVecEnv


class TimeIsUp(VecEnvWrapper):
    """The end of the time is the end of the task: learners do not add what might have come later."""

    def reset(self):
        """Begin new episodes."""
        return self.venv.reset()

    def step_wait(self):
        """One step."""
        *seen, infos = self.venv.step_wait()
        for info in infos:
            info.pop("TimeLimit.truncated", None)
        return *seen, infos


class Returns(BaseCallback):
    """Notes the return of every episode, of one robot per team: all robots are paid the same."""

    def __init__(self, robots: int):
        super().__init__()
        self.robots = robots
        self.noted: list[float] = []

    def _on_step(self) -> bool:
        self.noted += [info["episode"]["r"] for info in self.locals["infos"][:: self.robots] if "episode" in info]
        return True


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
