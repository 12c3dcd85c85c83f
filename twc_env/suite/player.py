"""One episode of a benchmark: a scripted team, one of a file, or a trained model."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from twc_env.agents.policy import is_model
from twc_env.config import override
from twc_env.exploration.assessment.evaluation import EpisodeResult
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.class_file import digest_of, is_in_file
from twc_env.running.finished_parts import code_digest
from twc_env.suite.entries import Entry

if TYPE_CHECKING:
    from twc_env.agents.policy import Policy

DIGITS = 6
"""Decimal places of coverage in the curves."""
UNSEEN = {
    f"observation.{block}": False
    for block in ("lidar", "map", "overview", "wifi", "signs", "team", "frontiers", "gains", "other_maps")
}
"""Teams that act on beliefs need no observations; one block has to be there."""
Acts = Callable[[dict[str, Any]], dict[str, Any] | None]
"""Observations -> actions; None when the team is finished."""


def digest_of_team(entry: Entry) -> str:
    """What determines the team's actions besides the code of twc_env and its agents; empty for scripted teams.

    Raises ConfigError for an unknown team, and one that cannot play this task, DataError for such a model.
    """
    if is_model(entry.team):
        from twc_env.suite.models import model_bytes, model_for

        content = model_bytes(entry)
        model_for(entry)
        return f"{hashlib.sha256(content).hexdigest()[:12]} {code_digest('twc_env.training')}"
    from twc_env.agents import make_policy

    make_policy(entry.team, entry.config)
    return digest_of(entry.team) if is_in_file(entry.team) else ""


def play(entry: Entry) -> dict[str, Any]:
    """Play one episode; returns plain values that do not depend on the machine.

    `coverage`: share of the floor mapped correctly by the best correctly merged group, every `period_s` of simulated
    time from the first period on; `merged_s`: when all robots first shared one correct map, None if never.
    """
    env, acts = _ready(entry)
    period_steps, time_step_s = env.config.reward.period_steps, env.config.dynamics.time_step_s
    covered: list[float] = []
    merged_s = None

    def note() -> None:
        nonlocal merged_s
        episode = env.episode
        if merged_s is None and episode.is_one_map:
            merged_s = round(episode.steps * time_step_s, DIGITS)
        if episode.steps % period_steps == 0:
            covered.append(round(episode.coverage, DIGITS))

    observations, _ = env.reset(seed=entry.number)
    env.watch(note)
    commands = []
    while env.agents and (actions := acts(observations)) is not None:
        observations = env.step(actions)[0]
        commands.append(actions)
    result, is_covered = env.result(), env.episode.is_covered
    figures = result.figures
    env.close()
    taken = "steps", "sim_time_s", "merged_robots", "wrong_merges", "bytes_sent", "collisions"
    return {
        "period_s": period_steps * time_step_s,
        "coverage": covered,
        "merged_s": merged_s,
        "is_covered": is_covered,
        "ate_m": round(figures["team_ate_m"], DIGITS),
        "path_m": round(figures["path_length_m"], 3),
        "stuck_share": round(_stuck_share(result, commands, env.possible_agents), DIGITS),
        **{key: figures[key] for key in taken},
    }


def _stuck_share(result: EpisodeResult, actions: Sequence[dict[str, Any]], agents: Sequence[str]) -> float:
    """`commanded_stuck_share`; of robots whose actions are goals, also while they wait."""
    from twc_env.agents.explore import commanded, commanded_stuck_share

    is_driven = result.config.action.kind == "velocity"
    steps = len(actions) if is_driven else len(result.true_poses) - 1
    commands = [commanded(each, agents) for each in actions] if is_driven else [[True] * len(agents)] * steps
    return commanded_stuck_share(result, commands)


def drive(env: ExplorationEnv, team: str, seed: int) -> list[list[bool]]:
    """Play a whole episode of an environment with a scripted team; returns whether each robot was told to move, step by
    step."""
    from twc_env.agents.explore import commanded
    from twc_env.agents.policy import begin, make_policy

    policy = make_policy(team, env.config)
    env.reset(seed=seed)
    begin(policy, team, env, seed)
    commands = []
    while env.agents and (actions := decided(env, policy)) is not None:
        env.step(actions)
        commands.append(commanded(actions, env.possible_agents))
    return commands


def decided(env: ExplorationEnv, policy: Policy) -> dict[str, Any] | None:
    """The next actions of a scripted team; None when it is finished."""
    from twc_env.agents.policy import is_finished

    beliefs = {name: env.belief(name) for name in env.agents}
    return None if is_finished(policy, beliefs) else policy.act(beliefs)


def _ready(entry: Entry) -> tuple[ExplorationEnv, Acts]:
    """The environment of an entry, and what the team does in it."""
    if is_model(entry.team):
        from twc_env.suite.models import model_in_task

        return model_in_task(entry)
    from twc_env.agents.policy import begin, make_policy

    env = ExplorationEnv(config=override(entry.config, UNSEEN))
    policy = make_policy(entry.team, entry.config)
    is_fresh = True

    def act(_: dict[str, Any]) -> dict[str, Any] | None:
        nonlocal is_fresh
        if is_fresh:
            begin(policy, entry.team, env, entry.number)
            is_fresh = False
        return decided(env, policy)

    return env, act
