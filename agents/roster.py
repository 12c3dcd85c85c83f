"""The scripted teams by name: where each is defined, what it does and where it was published."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Team:
    """One scripted team."""

    module: str
    """Below this package; imported when the team is made, so that `--help` starts quickly."""
    class_name: str
    summary: str
    """What it does, in one line."""
    source: str
    """Where it was published."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of its constructor."""
    is_oracle: bool = False
    """Whether it is given ground truth; every other team is given beliefs only."""


def _without(aware: Team, what: str) -> Team:
    """The blind twin of a team that is aware of SLAM: the same code without that part."""
    return Team(aware.module, aware.class_name, f"the same code {what}", "ablation", {"is_aware": False})


_RENDEZVOUS = Team(
    "slam_aware.rendezvous", "Rendezvous",
    "explores, and meets at appointed times: at landmarks, or where it agreed with teammates",
    "Roy and Dudek 2001; de Hoog, Cameron and Visser 2009",
)  # fmt: skip
_SIGN_SEEKER = Team(
    "slam_aware.sign_seeker", "SignSeeker",
    "drives where a sign can confirm how its map and that of another robot fit together",
    "Fox, Ko, Konolige, Limketkai, Schulz and Stewart 2006",
)  # fmt: skip
_CLOSURE_SEEKER = Team(
    "slam_aware.closure_seeker", "ClosureSeeker",
    "drives back to known floor when its own uncertainty says so",
    "Stachniss, Hähnel and Burgard 2004; Placed and Castellanos 2021",
)  # fmt: skip
_RELAY = Team(
    "slam_aware.relay", "Relay",
    "explores only where the robots of its group stay in radio range",
    "Rooker and Birk 2007",
)  # fmt: skip

TEAMS: dict[str, Team] = {
    "nearest-frontier": Team(
        "teams.nearest_frontier", "NearestFrontier",
        "nearest frontier that no teammate claims; tours signs when none is left",
        "Yamauchi 1998, with claims and tours; the reference team of v0",
    ),
    "greedy-frontier": Team(
        "teams.greedy_frontier", "GreedyFrontier",
        "each robot drives to its nearest frontier, without coordination",
        "Yamauchi 1998",
    ),
    "cost-utility": Team(
        "teams.cost_utility", "CostUtility",
        "trades off the way to a frontier against what teammates will see of it",
        "Burgard, Moors, Stachniss and Schneider 2005",
    ),
    "assignment": Team(
        "teams.assignment", "Assignment",
        "one frontier per robot, minimising the total path length",
        "Kuhn 1955",
    ),
    "voronoi": Team(
        "teams.voronoi", "Voronoi",
        "nearest-frontier, where each robot has the frontiers that it is closest to",
        "Voronoi partition of frontiers, based on the reference team of v0",
    ),
    "segments": Team(
        "teams.segments", "Segments",
        "one room per robot: the map is cut at the doors of its Voronoi graph",
        "Wurm, Stachniss and Burgard 2008",
    ),
    "minpos": Team(
        "teams.minpos", "MinPos",
        "the frontier to which fewest teammates are closer",
        "Bautin, Simonin and Charpillet 2012",
    ),
    "market": Team(
        "teams.market", "Market",
        "robots auction the goals of their tours to each other",
        "Zlot, Stentz, Dias and Thayer 2002",
    ),
    "information-gain": Team(
        "teams.information_gain", "InformationGain",
        "the view that is expected to tell most about the map, for its way",
        "Bourgault et al. 2002; González-Baños and Latombe 2002",
    ),
    "rrt": Team(
        "teams.rrt", "RRT",
        "frontiers found by rapidly-exploring random trees, by revenue",
        "Umari and Mukhopadhyay 2017",
    ),
    "potential-field": Team(
        "teams.potential_field", "PotentialField",
        "descends a potential of all frontiers, repelled by teammates",
        "Yu et al. 2021",
    ),
    "wall-follower": Team(
        "teams.wall_follower", "WallFollower",
        "follows walls",
        "papers.md K",
    ),
    "random": Team(
        "teams.random_walk", "RandomWalk",
        "wanders: smooth random velocities",
        "lower reference",
    ),
    "rendezvous": _RENDEZVOUS,
    "rendezvous-blind": _without(_RENDEZVOUS, "without meetings"),
    "sign-seeker": _SIGN_SEEKER,
    "sign-seeker-blind": _without(_SIGN_SEEKER, "without hypotheses"),
    "closure-seeker": _CLOSURE_SEEKER,
    "closure-seeker-blind": _without(_CLOSURE_SEEKER, "without returns"),
    "relay": _RELAY,
    "relay-blind": _without(_RELAY, "without the radio range"),
    "radio-frontier": Team(
        "radio.radio_frontier", "RadioFrontier",
        "nearest-frontier, preferring floor predicted from WiFi (slam.k_visibility.enabled=true)",
        "our own",
    ),
    "radio-walk": Team(
        "radio.radio_walk", "RadioWalk",
        "drives to where walls estimated from WiFi are least certain",
        "our own",
    ),
    "informed": Team(
        "oracle.informed", "Informed",
        "knows the true plan and all true poses",
        "upper reference",
        is_oracle=True,
    ),
}  # fmt: skip


def display_name(name: str) -> str:
    """The name of a team as tables print it: an oracle is marked as such."""
    return f"{name} (oracle)" if name in TEAMS and TEAMS[name].is_oracle else name
