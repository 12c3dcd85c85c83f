"""Metrics of an episode: plain arrays in, numbers out."""

from twc_env.metrics.closures import ClosureScore, closures_are_correct, score_closures
from twc_env.metrics.mapping import MapScore, correct_area_m2, floor_mask, recount_free, score_map
from twc_env.metrics.merging import implied_frames, wrong_pairs
from twc_env.metrics.trajectory import (
    absolute_trajectory_error_m,
    align_team,
    end_point_error_m,
    lay_map,
    path_length_m,
    stuck_share,
)
from twc_env.metrics.wall_thickness import wall_thickness_m

__all__ = [
    "ClosureScore",
    "MapScore",
    "absolute_trajectory_error_m",
    "align_team",
    "closures_are_correct",
    "correct_area_m2",
    "end_point_error_m",
    "floor_mask",
    "implied_frames",
    "lay_map",
    "path_length_m",
    "recount_free",
    "score_closures",
    "score_map",
    "stuck_share",
    "wall_thickness_m",
    "wrong_pairs",
]
