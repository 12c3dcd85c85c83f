"""The task that all tutorials learn, and the picture of a learning curve.

Two robots explore one small building, twin-01, and choose between frontiers. Only a few numbers are observed, so small
networks learn in minutes on one core.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

SETTINGS = {
    "map": "twin-01",
    "robots": 2,
    "max_cycles": 300,  # 30 s of simulated time, too few to see all of it by chance
    "action.kind": "frontier",
    "action.stay_s": 10.0,  # waiting is a choice too, and expensive
    "lidar.beam_count": 90,
    "reward.period_steps": 50,
    "observation.lidar": False,
    "observation.map": False,
    "observation.pose": False,
    "observation.wifi": False,
    "observation.signs": False,
}
"""Settings of the task; the return of an episode is the share of the floor that is mapped correctly at its end."""
TITLES = {
    "sb3": "PPO of stable-baselines3",
    "maskable_ppo": "MaskablePPO of sb3-contrib",
    "one_file": "PPO in one file",
    "torchrl": "PPO of TorchRL",
    "rllib": "PPO of RLlib",
    "benchmarl": "MAPPO of BenchMARL",
}
"""Of the pictures."""


def team_of(task: str | None = None) -> dict[str, Any]:
    """Arguments of `twc_env.parallel_env`: the small task, or a registered one as it is seen, decided and paid here."""
    if task is None:
        return {"config": SETTINGS}
    return {"task": task, "config": {k: v for k, v in SETTINGS.items() if k not in ("map", "robots", "max_cycles")}}


def save_curve(name: str, returns: list[float], folder: Path, parts: int = 10) -> None:
    """Write NAME.json with the returns of all episodes in the order in which they ended, and NAME.png with their curve.

    The curve shows means of `parts` equal parts of the episodes, with the standard error of each mean.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pieces = [piece for piece in np.array_split(np.array(returns), parts) if len(piece)]
    means = [float(piece.mean()) for piece in pieces]
    errors = [float(piece.std() / np.sqrt(len(piece))) for piece in pieces]
    ends = np.cumsum([len(piece) for piece in pieces]).tolist()
    curve = {"episodes": len(returns), "ends": ends, "means": means, "standard_errors": errors}
    (folder / f"{name}.json").write_text(json.dumps(curve, indent=1) + "\n")
    draw_curve(name, curve, folder / f"{name}.png")
    print(f"{len(returns)} episodes: mean return {means[0]:.3f} in the first part, {means[-1]:.3f} in the last")


def draw_curve(name: str, curve: dict[str, Any], path: Path) -> None:
    """Draw what `save_curve` wrote to NAME.json."""
    from matplotlib.figure import Figure

    means, errors, ends = np.array(curve["means"]), np.array(curve["standard_errors"]), curve["ends"]
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.fill_between(ends, means - errors, means + errors, color="#0072b2", alpha=0.25, linewidth=0)
    axes.plot(ends, means, color="#0072b2", marker="o", markersize=3)
    axes.axhline(means[0], color="0.5", linewidth=1, linestyle="--")
    axes.annotate("first part", (ends[-1], means[0]), ha="right", va="bottom", color="0.35")
    axes.set(xlabel="episodes", ylabel="floor mapped correctly", title=TITLES[name])
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)
