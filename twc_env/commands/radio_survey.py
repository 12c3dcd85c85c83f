"""`twc-env radio-survey`: wall maps from WiFi alone, by path length."""

from __future__ import annotations

import argparse

from twc_env.commands.team_options import paragraphs
from twc_env.running.options import add_folder, count, parse_seeds
from twc_env.running.terminal import tell

_SURVEY_HELP = """\
Map flats from WiFi alone with one robot, once by following the walls and once by driving to where its map is least
certain (`radio-walk`), and print map quality over path length. Walks finished by the same code are reused.

examples:
  twc-env radio-survey
  twc-env radio-survey --maps sfw-e4 sfw-e5 --seeds 0
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description, parser.epilog = paragraphs(_SURVEY_HELP)
    parser.add_argument(
        "--maps",
        nargs="+",
        metavar="MAP",
        default=[f"sfw-e{n}" for n in range(1, 7)],
        help="names or files (default: sfw-e1 to sfw-e6)",
    )
    parser.add_argument("--seeds", default="0-2", help="numbers and ranges")
    parser.add_argument("--steps", type=count, default=2500, help="maximum number of steps")
    add_folder(parser, "--out", "runs/radio-survey", "folder of finished walks")
    parser.set_defaults(run=_radio_survey)


def _radio_survey(options: argparse.Namespace) -> int:
    from twc_env import load_map
    from twc_env.agents.radio import radio_survey

    seeds = parse_seeds(options.seeds)
    for name in options.maps:
        load_map(name)
    found = radio_survey.compare(options.maps, seeds, options.steps, options.out, tell)
    for c in found:
        for agent, walked in zip(radio_survey.AGENTS, (c.along_walls, c.active), strict=True):
            print(
                f"{c.name} seed {c.seed} {agent:13s} {walked.path_m[-1]:6.1f} m  free IoU {walked.iou[-1]:.3f}, "
                f"among known cells {walked.iou_published[-1]:.3f} at coverage {walked.coverage[-1]:.3f}"
                f"{'' if walked.is_finished else ', not finished'}"
            )
    for share in (0.25, 0.5, 0.6, 0.75, 1.0):
        both = [c.at_share(share) for c in found]
        along, active = (sum(column) / len(column) for column in zip(*both, strict=True))
        print(
            f"after {share:4.0%} of the path along the walls: free IoU {along:.3f} wall following, {active:.3f} active"
        )
    for part in (0.5, 0.75, 0.9, 1.0):
        middle, low, high = radio_survey.median_share([c.path_share(part) for c in found])
        print(
            f"active path for {part:4.0%} of the final IoU of wall following: {middle:.2f} of the path that wall "
            f"following needs (median, 95 % interval {low:.2f} to {high:.2f}; inf: never reached)"
        )
    middle, low, high = radio_survey.median_share([c.bound(load_map(c.name)) for c in found])
    print(
        f"lower bound for 100% (shortest path found with known building and noise-free readings): {middle:.2f} "
        f"(median, 95 % interval {low:.2f} to {high:.2f})"
    )
    return 0
