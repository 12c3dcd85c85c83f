"""`twc-env watch`: a live window, with one robot to drive by hand."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

from twc_env.commands.team_options import add_team, agent_names, team_config
from twc_env.errors import ConfigError
from twc_env.records.json_values import TERMINAL, write_json
from twc_env.running.command_line import INTERRUPTED
from twc_env.running.command_start import Interruption
from twc_env.running.options import natural, number

_WATCH_HELP = """\
Watch a team explore in a window (extra `viz`). The true building is grey, the map that the robots have made black and
white; a disc is where a robot is, a ring where it believes to be, and a violet line is a loop closure. Until robots
share a map, the floor that each has seen is tinted in its colour.

With --drive you steer one robot by the arrow keys: up and down drive, left and right turn, and tab goes to the next
robot; the others are driven by the team. What to try:

- Drive in a straight line for a while: disc and ring drift apart, as odometry drifts.
- Return to a place with a sign: a violet line appears, and the ring jumps back onto the disc.
- Visit the room of another robot: as soon as both have read the same signs, their maps merge and lose their tint.

Keys: T true walls, M maps, C closures, P paths, S signal strength on or off; 1 to 9 one robot's map, 0 all maps; space
waits. At the end, the window stays until it is closed, and the result is printed.

examples:
  twc-env watch
  twc-env watch --drive 0 --map twin-02 --robots 2
  twc-env watch --map gen:office:800:7 --robots 5 --agent voronoi --speed 4
  twc-env watch --set people.count=10 --set odometry.drift=3
"""
FORWARD, TURN = 1.0, 0.8
"""Share of the greatest speed and turn rate at a held key."""
_DRIVEN = "arrows: drive robot {robot}  tab: next robot  "
_FREE = "tab: drive a robot  "


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    description, _, epilog = _WATCH_HELP.partition("\n\nexamples:")
    parser.description, parser.epilog = description, f"examples:{epilog}"
    parser.add_argument("--map", help="bundled name, generated name or file (default: twin-01)")
    parser.add_argument("--seed", type=natural, default=0, help="of start poses, noise and generated signs")
    parser.add_argument(
        "--agent",
        default="nearest-frontier",
        help=f"who drives the others: one of {agent_names()}",
    )
    parser.add_argument("--drive", type=natural, metavar="ROBOT", help="steer this robot by the arrow keys")
    parser.add_argument("--speed", type=number(0.1, 100), default=1.0, help="simulated seconds per second, at most")
    parser.add_argument("--signal", action="store_true", help="show signal strength from the beginning")
    parser.add_argument("--close", action="store_true", help="close the window at the end of the episode")
    parser.set_defaults(run=_watch)
    add_team(parser)


def _watch(options: argparse.Namespace) -> int:
    import numpy as np

    from twc_env.agents.policy import begin, is_finished, make_policy
    from twc_env.exploration.environment import ExplorationEnv

    config = team_config(options, options.map, options.steps)
    if options.drive is not None and options.drive >= config.robots:
        raise ConfigError(f"--drive names a robot from 0 to {config.robots - 1}; got {options.drive}")
    policy = make_policy(options.agent, config)
    env = ExplorationEnv(config=config, render_mode="human", render_signal=options.signal)
    window = env.window
    assert window is not None
    window.frames_per_s = options.speed / config.dynamics.time_step_s
    keys, choices = window.help_text, [None, *range(config.robots)]
    first = 0 if options.drive is None else 1 + options.drive
    with Interruption() as interruption:
        window.help_text = _told(choices[first]) + keys
        env.reset(seed=options.seed)
        begin(policy, options.agent, env, options.seed)
        while env.agents and not window.is_shut:
            driven = choices[(first + window.tabs) % len(choices)]
            window.help_text = _told(driven) + keys
            beliefs = {name: env.belief(name) for name in env.agents}
            if driven is None and is_finished(policy, beliefs):
                break
            actions = policy.act(beliefs)
            if driven is not None and isinstance(actions, Mapping):
                actions = {**actions, f"robot_{driven}": np.array(steering(window.held), np.float32)}
            env.step(actions)
        while not options.close and window.answer():
            env.render()
            window.wait()
    result = env.result()
    env.close()
    write_json(options.json, result.figures)
    if options.json != TERMINAL:
        print(result)
    return INTERRUPTED if interruption.came else 0


def steering(held: set[str]) -> tuple[float, float]:
    """Speed and turn rate, as shares of the greatest, for the arrow keys that are held."""
    forward = FORWARD * (("up" in held) - ("down" in held))
    return forward, TURN * (("left" in held) - ("right" in held))


def _told(robot: int | None) -> str:
    return _FREE if robot is None else _DRIVEN.format(robot=robot)
