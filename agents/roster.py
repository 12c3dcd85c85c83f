"""The scripted teams by name: where each is defined, what it does and where it was published."""

from __future__ import annotations

from dataclasses import dataclass


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
    twin: str = ""
    """Of a team that is aware of SLAM: the team that is the same code without that part."""
    is_oracle: bool = False
    """Whether it is given ground truth; every other team is given beliefs only."""


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
    "rendezvous": Team(
        "slam_aware.rendezvous", "Rendezvous",
        "explores, and meets at appointed times: at landmarks, or where it agreed with teammates",
        "Roy and Dudek 2001; de Hoog, Cameron and Visser 2009",
        twin="minpos",
    ),
    "sign-seeker": Team(
        "slam_aware.sign_seeker", "SignSeeker",
        "explores towards other maps, by access points that both heard and pending closures",
        "Fox, Ko, Konolige, Limketkai, Schulz and Stewart 2006; by radio: our own",
        twin="minpos",
    ),
    "closure-seeker": Team(
        "slam_aware.closure_seeker", "ClosureSeeker",
        "drives back to known floor when its own uncertainty says so",
        "Stachniss, Hähnel and Burgard 2004; Placed and Castellanos 2021",
        twin="minpos",
    ),
    "relay": Team(
        "slam_aware.relay", "Relay",
        "explores only where the robots of its group stay in radio range",
        "Rooker and Birk 2007",
        twin="minpos",
    ),
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
    "informed-no-merging": Team(
        "oracle.partly_informed", "WithoutMerging",
        "informed, but does not know what makes maps merge",
        "what the informed team knows, a piece at a time",
        is_oracle=True,
    ),
    "informed-plan-only": Team(
        "oracle.partly_informed", "WithoutTeammates",
        "informed, but robots know of others only while they share a map",
        "what the informed team knows, a piece at a time",
        is_oracle=True,
    ),
    "informed-poses-only": Team(
        "oracle.partly_informed", "WithoutPlan",
        "information-gain in one true frame, on what anybody has mapped",
        "what the informed team knows, a piece at a time",
        is_oracle=True,
    ),
}  # fmt: skip


def display_name(name: str) -> str:
    """The name of a team as tables print it: an oracle is marked as such."""
    return f"{name} (oracle)" if name in TEAMS and TEAMS[name].is_oracle else name
