"""Run a policy for one episode and write the run folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import twc_env
from twc_env import DataError, EnvConfig, EpisodeResult, EpisodeTrace, load_map
from twc_env.config import to_dict
from twc_env.datasets.buildings.ros_map import write_ros_maps
from twc_env.datasets.lasting_maps import prior_digest, save_map
from twc_env.datasets.logs.frame_log import write_frame_log
from twc_env.datasets.logs.g2o import write_g2o, write_vertices
from twc_env.datasets.logs.tum import write_tum
from twc_env.metrics import stuck_share
from twc_env.pictures.video import film_name
from twc_env.records.class_file import digest_of, is_in_file
from twc_env.records.json_values import plain, write_json
from twc_env.records.messages import Contacts, SensorFrame
from twc_env.running.clock import Clock
from twc_env.running.command_start import Interruption
from twc_env.running.finished_parts import code_digest
from twc_env.running.output_folder import alone_in

from . import picture
from .policy import LEARNED, begin, is_finished, is_model, make_policy

WARM_UP_STEPS = 10
"""Steps at the start that are excluded from the speed."""
STUCK_WINDOW_S, STUCK_RADIUS_M = 10.0, 0.3
"""As in `stuck_share` (docs/figures.md)."""
IDLE_SHARE = 0.05
_WRITTEN = (
    "config.json", "frames.npz", "trace.npz", "pose_graph.g2o", "pose_graph.csv", "trajectories/robot_*_*.tum",
    "map.yaml", "map.pgm", "map_[0-9]*.yaml", "map_[0-9]*.pgm", "map.png", "map.pdf", "map.svg", "*-seed*.gif",
    "episode.gif", "replay.html", "replay.rrd", "figures.csv", "figures.tex", ".part-*",
)  # fmt: skip
"""Files of a run folder besides the report."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One finished episode of a policy."""

    result: EpisodeResult
    report: dict[str, Any]
    """The figures of the result, and also agent, digests of code and map, and speeds."""
    film: picture.Film | None
    was_interrupted: bool
    frames: Sequence[Sequence[SensorFrame]]
    contacts: list[Contacts]
    """All sensor frames, step by step; `twc-env replay` runs the engine on them again."""
    trace: EpisodeTrace
    """Poses, maps and figures over time; `twc-env replay RUN --html` shows them."""
    saved: str | None = None
    """What was saved of the map for later sessions: file, size and contents; None if nothing was to be saved."""


def explore(
    config: EnvConfig,
    agent: str,
    seed: int,
    film: picture.Film | None = None,
    watch: Callable[[int, float], None] | None = None,
    save: Path | None = None,
) -> Run:
    """Run one episode until the policy is finished, `config.max_cycles` steps are over or Ctrl-C is pressed (of
    `twc-env`, also SIGTERM).

    `watch` is called with the number of steps taken and the share of the floor that was mapped correctly when the
    rewards were last evaluated; `save` is the file for the map. Raises TwcError for an unknown agent or map.
    """
    policy = make_policy(agent, config)
    own = file_digests(config, agent)  # before the episode: files may change, and `save` may be `slam.prior`
    env = twc_env.parallel_env(config=config, render_mode="rgb_array" if film else None)
    env.reset(seed=seed)
    begin(policy, agent, env, seed)
    frames, contacts, trace, commands = [env.frames], [env.contacts], EpisodeTrace(env), []
    thought_s, env_s, counted, step = 0.0, 0.0, 0, 0
    with Interruption() as interruption, Clock() as clock:
        while env.agents:
            start = clock.now_s()
            beliefs = {name: env.belief(name) for name in env.agents}
            believed = clock.now_s()
            actions = policy.act(beliefs)
            is_over = is_finished(policy, beliefs)
            thought = clock.now_s()
            if is_over:
                break
            rewards = env.step(actions)[1]
            stepped = clock.now_s()
            commands.append(commanded(actions, env.possible_agents))
            frames.append(env.frames)
            contacts.append(env.contacts)
            trace.note(rewards)
            thought_s += thought - believed
            step += 1
            if step > WARM_UP_STEPS:
                env_s, counted = env_s + (believed - start) + (stepped - thought), counted + 1
            if film is not None and film.wants(step):
                _film(film, step, env)
            if watch is not None:
                watch(step, env.episode.coverage)
    result = env.result()
    saved = None if save is None else save_map(save, env.engine)
    if film is not None and (step == 0 or not film.wants(step)):
        _film(film, step, env)
    env.close()
    speeds = {"env_steps_per_s": counted / env_s if env_s else None, "agent_s": thought_s}
    stuck = {"commanded_stuck_share": commanded_stuck_share(result, commands)}
    report = plain({**result.figures, **stuck, "agent": agent, **origin_of(result.config, agent), **own, **speeds})
    return Run(result, report, film, interruption.came, frames, contacts, trace, saved)


def commanded(actions: Mapping[str, Any], agents: Sequence[str]) -> list[bool]:
    """Whether each agent is told to drive or turn by more than `IDLE_SHARE` of the maximum, by actions that `step` has
    accepted."""
    return [agent in actions and bool(np.abs(actions[agent]).max() > IDLE_SHARE) for agent in agents]


def commanded_stuck_share(result: EpisodeResult, commands: Sequence[Sequence[bool]]) -> float:
    """`stuck_share` of robots that were told to move: one that waits is not stuck."""
    window = max(int(STUCK_WINDOW_S / result.config.dynamics.time_step_s), 1)
    count = min(len(commands), len(result.true_poses) - 1)
    if count < 1:
        return 0.0
    return stuck_share(result.true_poses[: count + 1], window, STUCK_RADIUS_M, np.array(commands[:count]))


def origin_of(config: EnvConfig, agent: str) -> dict[str, str]:
    """Digests of what determines a run besides its settings: the code of twc_env and agents, the floor plan, and
    `file_digests`."""
    packages = ("twc_env.agents", "twc_env.training") if is_model(agent) else ("twc_env.agents",)
    return {
        "code_digest": code_digest(*packages),
        "map_digest": load_map(config.map).digest,
        **file_digests(config, agent),
    }


def file_digests(config: EnvConfig, agent: str) -> dict[str, str]:
    """Digests of the user's own files: agents, recognisers, back ends and the map of an earlier session."""
    slam = config.slam
    named = {
        "agent_digest": agent,
        "recogniser_digest": slam.place_recognition.recogniser,
        "back_end_digest": slam.pose_graph.robust,
    }
    own = {key: digest_of(name) for key, name in named.items() if is_in_file(name)}
    if digits := prior_digest(config):
        own["prior_digest"] = digits
    if is_model(agent) and agent != LEARNED:
        model = Path(agent, "model.safetensors") if Path(agent).is_dir() else Path(agent)
        own["agent_digest"] = hashlib.sha256(model.read_bytes()).hexdigest()[:8]
    return own


def _film(film: picture.Film, step: int, env: twc_env.ExplorationEnv) -> None:
    frame = env.render()
    if frame is not None:
        film.add(step, frame)


def write_run(run: Run, folder: Path, pictures: bool = True, format: str = "png", dpi: float | None = None) -> None:
    """Write the run folder: config, frames, pictures, trajectories, pose graph, maps, and finally the report.

    format: of the map picture, png, pdf or svg. Files of an earlier run are deleted first, so that all files belong to
    one run. Concurrent runs write one after the other.
    """
    with alone_in(folder):
        _write_files(run, folder, (format, dpi) if pictures else None)


def _write_files(run: Run, folder: Path, pictures: tuple[str, float | None] | None) -> None:
    result = run.result
    try:
        _clear(folder)
        (folder / "trajectories").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the run folder {folder}: {error.strerror}; choose another with --out") from error
    write_json(folder / "config.json", to_dict(result.config))
    times_s = np.arange(len(result.true_poses)) * result.config.dynamics.time_step_s
    for kind in ("true", "estimated", "odometry"):
        poses = getattr(result, f"{kind}_poses")
        for robot in range(poses.shape[1]):
            write_tum(folder / "trajectories" / f"robot_{robot}_{kind}.tum", times_s, poses[:, robot])
    if any(run.frames):  # there are none if all robots have failed at the start
        write_frame_log(folder / "frames.npz", result.config, run.frames, run.contacts)
    run.trace.write(folder / "trace.npz")
    write_g2o(folder / "pose_graph.g2o", result.graph)
    write_vertices(folder / "pose_graph.csv", result.graph)
    write_ros_maps(result.grids, folder)
    if pictures is not None:
        picture.draw_map(result, folder / f"map.{pictures[0]}", pictures[1])
        if run.film is not None:
            run.film.write(folder / film_name(result.floorplan.name, result.seed))
    write_json(folder / "report.json", run.report)


def _clear(folder: Path) -> None:
    """Delete the files of an earlier run, its report first, if there is a report or an interrupted run without one."""
    was_killed = (folder / "config.json").is_file() and (folder / "trajectories").is_dir()
    if not (was_killed or (folder / "report.json").is_file()):
        return
    (folder / "report.json").unlink(missing_ok=True)
    for pattern in _WRITTEN:
        for path in folder.glob(pattern):
            path.unlink()
