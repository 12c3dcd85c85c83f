"""Planning on estimated maps: traversal costs, frontiers, views, path search, path following, coverage walks."""

from typing import NoReturn

from twc_env.planning.candidates import Candidates, can_tell_places, find_candidates, find_views
from twc_env.planning.covering_walk import WalkGraph, covering_walk, walk_graph
from twc_env.planning.drivers import Drivers
from twc_env.planning.felt_obstacles import FeltObstacles, shown
from twc_env.planning.floor_views import FloorViews, place_graph
from twc_env.planning.follow import Follower, as_action, can_reverse, drive_to, room_around_m
from twc_env.planning.latency_tours import LatencyTours, TeamState
from twc_env.planning.moving_obstacles import MovingObstacles, has_glass
from twc_env.planning.other_maps import OtherMaps
from twc_env.planning.path_finder import Disc, PathFinder, Plan
from twc_env.planning.radio_whereabouts import Whereabouts, whereabouts
from twc_env.planning.terrain import FREE, UNKNOWN, WALL, Terrain, is_frontier
from twc_env.planning.views import RandomTree, ViewGain

__all__ = [
    "FREE",
    "UNKNOWN",
    "WALL",
    "Candidates",
    "Disc",
    "Drivers",
    "FeltObstacles",
    "FloorViews",
    "Follower",
    "LatencyTours",
    "MovingObstacles",
    "OtherMaps",
    "PathFinder",
    "Plan",
    "RandomTree",
    "TeamState",
    "Terrain",
    "ViewGain",
    "WalkGraph",
    "Whereabouts",
    "as_action",
    "can_reverse",
    "can_tell_places",
    "covering_walk",
    "drive_to",
    "find_candidates",
    "find_views",
    "has_glass",
    "is_frontier",
    "place_graph",
    "room_around_m",
    "shown",
    "walk_graph",
    "whereabouts",
]

_RENAMED = {"Driver": "Drivers, of all robots", "path_is_blocked": "Follower.is_blocked"}


def __getattr__(name: str) -> NoReturn:
    if name in _RENAMED:
        raise ImportError(f"twc_env.planning.{name} is now twc_env.planning.{_RENAMED[name]}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
