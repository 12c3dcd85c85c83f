"""Multi-agent PPO for decisions of different length: one policy for all robots, one critic that sees the truth.

Runnable alone: `python training/mappo.py --task ExploreQuick-v1`, or `twc-env train mappo`.

MAPPO is PPO (Schulman et al. 2017) with a shared policy and a centralised value function, which sees the true state in
training only (Yu et al. 2022, "The surprising effectiveness of PPO in cooperative multi-agent games"). Robots decide
asynchronously: each has its own sequence of decisions, a decision earns what its robot is rewarded with until its next
one, and the discount counts time, not decisions (semi-Markov, Sutton, Precup and Singh 1999).

What is maximised is the mean over time of the mapped floor, which is the score of the benchmark: floor that is mapped
when a share `clock` of the time is left counts `clock` times.

Everything random comes from streams named by seed and update, and each environment gets the same number of steps per
update. So the result depends neither on the number of processes nor on whether the run was killed and resumed.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray as Array
from torch import Tensor, nn
from twc_env.training.checkpoint import below, load, prefixed, save
from twc_env.training.encoder import USED, Actor, Encoder
from twc_env.training.episode_totals import EpisodeTotals
from twc_env.training.learning_curve import LearningCurve
from twc_env.training.run_folder import Task, check_choices, check_run, open_run
from twc_env.training.team_notes import TeamNotes
from twc_env.training.weights import arrays_of, arrays_of_adam, fill, fill_adam

from twc_env.records.random_streams import random_stream
from twc_env.vector.teams import VectorTeams

STATE_FIGURES = 8
"""Per robot, for the critic."""
HALF_WAY_M = 10.0
"""Distances d of the state are shown as d / (d + this)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters."""

    seed: int = 0
    """Seed of the weights, of sampling and of the episodes."""
    steps: int = 60_000
    """Total decisions, rounded up to whole updates; a busy robot decides nothing."""
    environments: int = 16
    """Teams that play at once."""
    workers: int = 2
    """Processes that share the environments; results do not depend on them."""
    rollout_steps: int = 32
    """Steps of each environment between two updates; in each, one robot or more decide."""
    learning_rate: float = 1e-3
    """Initial step size of Adam, annealed linearly to 0, so that the result does not depend on the last rollouts."""
    discount: float = 0.995
    """Per second, as decisions differ in length."""
    gae_lambda: float = 0.95
    """Per decision (generalised advantage estimation, Schulman et al. 2016)."""
    clip: float = 0.2
    """Greatest change of a probability ratio that is rewarded."""
    entropy_weight: float = 0.002
    """Bonus for uncertain choices, against premature convergence."""
    epochs: int = 5
    """Passes over each rollout."""
    minibatches: int = 4
    """Gradient steps per pass."""
    hidden_size: int = 64
    """Width of the networks."""
    gradient_max: float = 0.5
    """Norm to which gradients are clipped."""
    blind: tuple[str, ...] = ()
    """What the policy does not know of: some of teammates, signs and map (`blindness`). The critic does."""
    attention: bool = True
    """Whether what the policy sees attends to each other; else each choice is encoded by itself (`FeedForward`)."""
    privileged_critic: bool = True
    """Whether the critic sees the truth; else what the robot sees, and nothing more."""
    from_rule: bool = True
    """Whether training starts from the weights of `RULE`; else from 0, where all choices are alike."""


class Critic(nn.Module):
    """Expected rest of the return of a robot that decides: from what it sees, the floor that is mapped correctly, and
    where all robots truly are."""

    def __init__(self, space: spaces.Dict, width: int, is_privileged: bool = True):
        """is_privileged: else it sees what the robot sees, and nothing more."""
        super().__init__()
        self.encoder = Encoder(space, width)
        robot = nn.Sequential(nn.Linear(STATE_FIGURES, width), nn.ReLU(), nn.Linear(width, width))
        self.robot = robot if is_privileged else None
        seen = 3 * width + 1 if is_privileged else width
        self.worth = nn.Sequential(nn.Linear(seen, width), nn.Tanh(), nn.Linear(width, 1))

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch,) values; besides the blocks of the policy, `gained` (batch, 1) and `state` (batch, robots, 8)."""
        if self.robot is None:
            return self.worth(self.encoder(seen)[1])[:, 0]
        robots = self.robot(seen["state"])
        parts = [self.encoder(seen)[1], robots.mean(1), robots.amax(1), seen["gained"]]
        return self.worth(torch.cat(parts, 1))[:, 0]


def state_of(state: Array, robot: Array) -> Array:
    """(n, robots, 8) of all robots as seen from the one that decides: true offset ahead and left, both as d / (d + 10
    m) with their sign, turn (cosine, sine), the same offset as estimated, 1 for the robot itself, and distance.

    state: (n, 6 robots) as from `ExplorationEnv.state`; robot: (n,).
    """
    poses = state.reshape(len(state), -1, 6).astype(float)
    own = poses[np.arange(len(robot)), robot][:, None]  # (n, 1, 6)
    figures = np.zeros((*poses.shape[:2], STATE_FIGURES), np.float32)
    for true, at in ((0, 0), (3, 4)):
        dx, dy = (poses[..., true + k] - own[..., true + k] for k in (0, 1))
        c, s = np.cos(own[..., true + 2]), np.sin(own[..., true + 2])
        for k, offset in enumerate((c * dx + s * dy, c * dy - s * dx)):
            figures[..., at + k] = offset / (np.abs(offset) + HALF_WAY_M)
    turn = poses[..., 2] - own[..., 2]
    figures[..., 2], figures[..., 3] = np.cos(turn), np.sin(turn)
    figures[np.arange(len(robot)), robot, 6] = 1.0
    away = np.hypot(poses[..., 0] - own[..., 0], poses[..., 1] - own[..., 1])
    figures[..., 7] = away / (away + HALF_WAY_M)
    return figures


@dataclass(slots=True)
class Decision:
    """One choice of one robot, and what came of it until its next one."""

    seen: dict[str, Array]
    """Blocks of `USED`, `gained`, and `state`: the true one."""
    robot: int
    action: int
    log_chance: float
    """Logarithm of the probability with which it was chosen."""
    reward: float = 0.0
    """Discounted to the moment of the decision."""
    time_steps: int = 0
    is_last: bool = False
    """Whether the episode ended before the next one."""


class Rollouts:
    """Plays the environments, and cuts what happens into the decisions of each robot."""

    def __init__(self, task: Task, settings: Settings, ray: str | None = None):
        """ray: address of a Ray cluster whose workers play."""
        config = task.config
        self._settings = settings
        self._teams = VectorTeams(settings.environments, config, settings.workers, task.training_maps, ray)
        self.space = TeamNotes.space(self._teams.observation_space)
        self._used = [name for name in (*USED, "gained") if name in self.space.spaces]
        self._count, self._robots = settings.environments, self._teams.robots
        self._discount = settings.discount**config.dynamics.time_step_s
        self._notes = TeamNotes(self._count, self._robots, config.max_cycles)
        self._seen: dict[str, Array] = {}
        """Block -> (environments, robots, ...): what each robot sees now."""
        self._open: list[list[Decision | None]] = [[None] * self._robots for _ in range(self._count)]
        """Decisions that still last."""
        self._totals = EpisodeTotals(self._count)
        self.clock, self.inferred_s = time.perf_counter, 0.0
        """How time is measured, and the time that `collect` spent with the policy."""

    def begin(self) -> None:
        """Begin new episodes."""
        self._start(self._teams.reset(1_000_003 * self._settings.seed))

    def _start(self, seen: dict[str, Array]) -> None:
        self._see(seen, np.arange(self._count))
        gc.freeze()  # collections need not visit the objects of the libraries

    def collect(
        self, policy: Callable[[dict[str, Array]], Array], update: int
    ) -> tuple[list[list[Decision]], list[dict]]:
        """`rollout_steps` steps of each environment: the decisions that ended meanwhile, one list per robot, and what
        the episodes that ended were like."""
        settings = self._settings
        chance = random_stream(settings.seed, "sampling", update)
        uniform = chance.random((settings.rollout_steps, self._count, self._robots))
        closed: list[list[list[Decision]]] = [[[] for _ in range(self._robots)] for _ in range(self._count)]
        episodes: list[tuple[int, int, dict]] = []
        self.inferred_s = 0.0
        steps, ready, in_flight = np.zeros(self._count, int), np.arange(self._count), 0
        while len(ready := ready[steps[ready] < settings.rollout_steps]) or in_flight:
            if len(ready):
                began = self.clock()
                actions = self._decide(policy, ready, uniform[steps[ready], ready], closed)
                self.inferred_s += self.clock() - began
                self._teams.send(actions, ready)
                in_flight += len(ready)
            wanted = max(1, in_flight // 2) if self._teams.workers > 1 else in_flight
            ready, seen, rewards, ended, infos = self._teams.recv(wanted)
            in_flight -= len(ready)
            for k, each in zip(ready.tolist(), self._take(ready, seen, rewards, ended, infos, closed), strict=True):
                if each:
                    episodes.append((int(steps[k]), k, each))
                steps[k] += 1
        episodes.sort(key=lambda one: one[:2])  # not by who came first
        return [own for robots in closed for own in robots], [each for _, _, each in episodes]

    def lasting(self) -> list[Decision | None]:
        """The decision that still lasts of each robot, in the order of `collect`."""
        return [each for robots in self._open for each in robots]

    def _decide(self, policy: Callable, ready: Array, uniform: Array, closed: list) -> Array:
        """Actions (len(ready), robots) for the environments `ready`; new decisions are opened."""
        everything = policy(rows_of(self._seen))  # of the same size at each call, whoever is ready
        mask = self._seen["action_mask"][ready] > 0
        chances, actions = drawn(everything.reshape(self._count, self._robots, -1)[ready], mask, uniform)
        deciding, states = mask.sum(-1) > 1, self._teams.states(ready)
        actions = np.where(deciding, actions, mask.shape[-1] - 1)
        for i, robot in zip(*(each.tolist() for each in np.nonzero(deciding)), strict=True):
            k, action = int(ready[i]), int(actions[i, robot])
            if (before := self._open[k][robot]) is not None:
                closed[k][robot].append(before)
            seen = {name: self._seen[name][k, robot].copy() for name in self._used}
            seen["state"] = states[i].copy()
            self._open[k][robot] = Decision(seen, robot, action, float(np.log(chances[i, robot, action])))
        rows = rows_of({name: block[ready] for name, block in self._seen.items()})
        self._notes.note_choices(rows, actions.ravel(), ready)
        return actions

    def _take(self, ids: Array, seen: dict, rewards: Array, ended: Array, infos: list, closed: list) -> list[dict]:
        """Process a step of the environments `ids`; returns what each episode that ended was like, else nothing."""
        took = np.array([info[0]["time_steps"] for info in infos])
        self._notes.note_outcome(np.repeat(took, self._robots), 0.0, False, ids)
        paid = rewards * self._notes.time_left(ids).reshape(len(ids), -1)
        told = []
        for i, k in enumerate(ids.tolist()):
            for robot, each in enumerate(self._open[k]):
                if each is not None:
                    each.reward += self._discount**each.time_steps * float(paid[i, robot])
                    each.time_steps += int(took[i])
                    if ended[i]:
                        each.is_last, self._open[k][robot] = True, None
                        closed[k][robot].append(each)
            told.append(self._totals.add(k, paid[i], rewards[i], infos[i], ended[i]))
        self._notes.note_outcome(0, rewards.ravel(), np.repeat(ended, self._robots), ids)
        self._see(seen, ids)
        return told

    def _see(self, seen: dict[str, Array], ids: Array) -> None:
        """Remember what the robots of these environments see."""
        for name, block in self._notes.beside(rows_of(seen), ids).items():
            whole = (self._count, self._robots, *block.shape[1:])
            own = self._seen.setdefault(name, np.zeros(whole, block.dtype))
            own[ids] = block.reshape(len(ids), *whole[1:])

    def snapshot(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and values from which `restore` plays on exactly: seeds and actions of the present episodes, notes on
        them, and the decisions that last."""
        arrays, told = {**prefixed("teams.", self._teams.snapshot()), **prefixed("notes.", self._notes.arrays())}, []
        for k in range(self._count):
            for robot, each in enumerate(self._open[k]):
                if each is not None:
                    arrays |= prefixed(f"open.{k}.{robot}.", each.seen)
                    told.append([k, robot, each.action, each.log_chance, each.reward, each.time_steps])
        return arrays, {"open": told, "totals": self._totals.of}

    def restore(self, arrays: dict[str, Array], told: dict[str, Any]) -> None:
        """Play the present episodes again up to where they were; an environment does the same for the same actions."""
        self._notes.fill(below(arrays, "notes."))
        self._totals.of = told["totals"]
        self._start(self._teams.restore(below(arrays, "teams.")))
        for k, robot, action, log_chance, reward, time_steps in told["open"]:
            blocks = below(arrays, f"open.{k}.{robot}.")
            self._open[k][robot] = Decision(blocks, robot, action, log_chance, reward, time_steps)

    def close(self) -> None:
        """End the worker processes."""
        self._teams.close()
        gc.unfreeze()


@dataclass(frozen=True, slots=True)
class Batch:
    """Decisions as tensors, one row each."""

    seen: dict[str, Tensor]
    actions: Tensor
    log_chances: Tensor
    advantages: Tensor
    returns: Tensor

    def of(self, rows: Array) -> Batch:
        """Some of them."""
        seen = {name: block[rows] for name, block in self.seen.items()}
        return Batch(seen, self.actions[rows], self.log_chances[rows], self.advantages[rows], self.returns[rows])


def rows_of(blocks: dict[str, Array]) -> dict[str, Array]:
    """Blocks (environments, robots, ...) with one row per robot."""
    return {name: block.reshape(-1, *block.shape[2:]) for name, block in blocks.items()}


def drawn(logits: Array, mask: Array, uniform: Array) -> tuple[Array, Array]:
    """Probabilities (..., choices), 0 where masked, and the choices (...) that numbers in [0, 1) draw from them."""
    chances = np.where(mask, np.exp(logits - logits.max(-1, keepdims=True)), 0.0)
    chances /= chances.sum(-1, keepdims=True)
    reached = np.cumsum(chances, -1)
    return chances, (uniform[..., None] * reached[..., -1:] >= reached).sum(-1)


class Learner:
    """The networks and their optimiser."""

    def __init__(self, space: spaces.Dict, settings: Settings, time_step_s: float):
        self._settings, self._space = settings, space
        self._discount = settings.discount**time_step_s
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.actor = Actor(space, settings.hidden_size, settings.blind, settings.attention)
            self.critic = Critic(space, settings.hidden_size, settings.privileged_critic)
        if not settings.from_rule:
            nn.init.zeros_(self.actor.rule)
        parameters = [*self.actor.parameters(), *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate, eps=1e-5)

    def logits(self, seen: dict[str, Array]) -> Array:
        """(batch, choices) of the policy."""
        with torch.inference_mode():
            found: Array = self.actor(tensors_of({k: seen[k] for k in USED if k in seen})).numpy()
        return found

    def learn(self, sequences: list[list[Decision]], lasting: list[Decision | None], update: int, left: float) -> dict:
        """One update from the decisions that ended. lasting: the next one of each sequence; left: share of the
        training that is left. Returns figures of it."""
        settings = self._settings
        done = [each for own in sequences for each in own]
        ahead = [each for each in lasting if each is not None]
        if not done:
            return {}
        seen, next_seen = batch_of(done), batch_of(ahead) if ahead else None
        with torch.no_grad():
            values = self.critic(seen).numpy()
            after = iter([] if next_seen is None else self.critic(next_seen).tolist())
        advantages = self._advantages(sequences, values, [None if each is None else next(after) for each in lasting])
        whole = Batch(
            seen,
            torch.tensor([each.action for each in done]),
            torch.tensor([each.log_chance for each in done]),
            torch.tensor(advantages, dtype=torch.float32),
            torch.tensor(advantages + values).float(),
        )
        step_size = self.optimizer.param_groups[0]["lr"] = settings.learning_rate * left
        order, told = random_stream(settings.seed, "minibatches", update), []
        for _ in range(settings.epochs):
            for part in np.array_split(order.permutation(len(done)), min(settings.minibatches, len(done))):
                losses = self._losses(whole.of(part))
                self.optimizer.zero_grad()
                loss = losses["policy_loss"] - settings.entropy_weight * losses["entropy"]
                (loss + losses["value_loss"]).backward()
                for network in (self.actor, self.critic):
                    nn.utils.clip_grad_norm_(network.parameters(), settings.gradient_max)
                self.optimizer.step()
                told.append({name: float(value.detach()) for name, value in losses.items()})
        spread = float(np.var(advantages + values))
        figures = {f"train/{name}": float(np.mean([each[name] for each in told])) for name in told[0]}
        explained = 1.0 - float(np.var(advantages)) / spread if spread > 0.0 else 0.0
        return {**figures, "train/explained_variance": explained, "train/learning_rate": step_size}

    def _losses(self, batch: Batch) -> dict[str, Tensor]:
        """PPO's clipped loss with normalised advantages, entropy, squared error of the critic, share of clipped
        ratios."""
        chances = torch.log_softmax(self.actor(batch.seen), 1)
        ratio = torch.exp(chances.gather(1, batch.actions[:, None])[:, 0] - batch.log_chances)
        limited = ratio.clamp(1.0 - self._settings.clip, 1.0 + self._settings.clip)
        gain = batch.advantages
        gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
        return {
            "policy_loss": -torch.minimum(ratio * gain, limited * gain).mean(),
            "value_loss": (self.critic(batch.seen) - batch.returns).square().mean(),
            "entropy": -(chances.exp() * chances.clamp(min=-50.0)).sum(1).mean(),
            "clipped_share": (ratio - limited).abs().gt(0).float().mean(),
        }

    def _advantages(self, sequences: list[list[Decision]], values: Array, next_values: list[float | None]) -> Array:
        """Generalised advantages of all decisions, in order; a decision is discounted by its duration."""
        advantages, end = np.zeros(len(values)), len(values)
        for own, next_value in zip(reversed(sequences), reversed(next_values), strict=True):
            advantage, value = 0.0, next_value or 0.0
            for at, each in zip(range(end - 1, end - 1 - len(own), -1), reversed(own), strict=True):
                discount = 0.0 if each.is_last else self._discount**each.time_steps
                surprise = each.reward + discount * value - float(values[at])
                advantage = surprise + discount * self._settings.gae_lambda * advantage
                advantages[at], value = advantage, float(values[at])
            end -= len(own)
        return advantages

    def arrays(self) -> dict[str, Array]:
        """Weights and moments."""
        return {
            **arrays_of(self.actor, "actor."), **arrays_of(self.critic, "critic."),
            **arrays_of_adam(self.optimizer, "optimizer."),
        }  # fmt: skip

    def fill(self, arrays: dict[str, Array], path: Path) -> None:
        """Set what `arrays` gave."""
        fill(self.actor, below(arrays, "actor."), path)
        fill(self.critic, below(arrays, "critic."), path)
        fill_adam(self.optimizer, below(arrays, "optimizer."), path)


def tensors_of(seen: dict[str, Array]) -> dict[str, Tensor]:
    """Blocks as tensors of single precision."""
    return {name: torch.from_numpy(np.ascontiguousarray(block, np.float32)) for name, block in seen.items()}


def batch_of(decisions: list[Decision]) -> dict[str, Tensor]:
    """What was seen at some decisions, one row each."""
    rows = {name: np.stack([each.seen[name] for each in decisions]) for name in decisions[0].seen}
    rows["state"] = state_of(rows["state"], np.array([each.robot for each in decisions]))
    return tensors_of(rows)


def train(
    task: Task,
    settings: Settings,
    folder: Path,
    resume: bool = False,
    show_progress: bool = True,
    ray: str | None = None,
) -> Path:
    """Train for `settings.steps` decisions; returns the path of the checkpoint, which is written after each update.

    `resume` continues from the checkpoint in `folder`, with the result of a run that was never interrupted. ray:
    address of a Ray cluster whose workers play, or "auto"; the result is the same. Raises DataError if there is
    nothing to resume, if the folder holds a run and `resume` is not given, or if another process trains in it.
    """
    torch.set_num_threads(1)  # the networks are small, and the environments need the cores
    config = check_choices(task)
    check_run(folder, "mappo", task, settings, resume)
    with (
        closing(Rollouts(task, settings, ray)) as rollouts,
        open_run(folder, "mappo", task, settings, resume) as path,
    ):
        learner = Learner(rollouts.space, settings, config.dynamics.time_step_s)
        told: dict[str, Any] = {"update": 0, "decisions": 0, "curve": {}}
        if resume:
            arrays, told = load(path)
            learner.fill(arrays, path)
            rollouts.restore(below(arrays, "rollouts."), told)
        else:
            rollouts.begin()
        update, decisions = told["update"], told["decisions"]
        with LearningCurve(folder, settings.steps, decisions, told["curve"], show_progress) as curve:
            while decisions < settings.steps:
                began = time.perf_counter()
                sequences, episodes = rollouts.collect(learner.logits, update)
                learnt = time.perf_counter()
                figures = learner.learn(sequences, rollouts.lasting(), update, 1.0 - decisions / settings.steps)
                ended = time.perf_counter()
                count = sum(len(own) for own in sequences)
                update, decisions = update + 1, decisions + count
                figures["speed/decisions_per_s"] = count / (ended - began)
                inferred_s = rollouts.inferred_s
                parts = {"environments": learnt - began - inferred_s, "inference": inferred_s, "update": ended - learnt}
                figures |= {f"speed/{name}_share": part_s / (ended - began) for name, part_s in parts.items()}
                curve.note(decisions, count, episodes, figures)
                arrays, told = rollouts.snapshot()
                told |= {"update": update, "decisions": decisions, "curve": curve.values()}
                save(path, {**learner.arrays(), **prefixed("rollouts.", arrays)}, told)
    return path


if __name__ == "__main__":
    import runpy
    import sys

    sys.argv[1:1] = ["train", "mappo"]
    runpy.run_module("twc_env", run_name="__main__")
