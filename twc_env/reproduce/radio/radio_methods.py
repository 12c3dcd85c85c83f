"""The methods of the radio SLAM paper's Table 1, each run on one walk: odometry, radio, radio with laser, GMapping."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, LidarConfig, RadioSlamConfig, override
from twc_env.maps import load_map
from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.records.geometry import compose
from twc_env.records.messages import Fingerprint, GridMap, SensorFrame, WifiScan
from twc_env.reproduce.radio import radio_walks
from twc_env.reproduce.radio.radio_twins import ONE_BAND, Place, record, true_path
from twc_env.reproduce.radio.radio_walks import RecordedWalk
from twc_env.slam.front_end.particle_filter import ParticleFilterSettings, map_frames
from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio import radio_lidar, radio_slam
from twc_env.slam.radio.radio_map import GaussianProcessMap, RadioMap
from twc_env.slam.radio.similarity_model import SimilarityModel
from twc_env.slam.robot import FrontEnds

LIDAR = LidarConfig(beam_count=360, range_max_m=20.0)
CONFIG = EnvConfig(robots=1, lidar=LIDAR)
"""One robot with the paper's scanner."""
PRINTED_RULE = override(CONFIG, {"slam.verification.method": "fitness"})
"""ICP, and the rule by which the paper accepts it (papers.md R12)."""
FALSE_DISTANCE_M, FALSE_VARIANCE_M2 = 3.0, 4.0
"""Distance and variance of a false closure, similar to those of true ones."""
PARTICLE_STRIDE, PARTICLE_CELL_M = 2, 0.2
"""The particle filter uses every second beam and this cell size, because it holds twenty maps of a whole campus."""
MAP_PLACES_MAX = 300
"""Places of a radio map for localisation: a Gaussian process takes time by their cube."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The result of a method on a walk."""

    truth: Array
    """(n, 3)."""
    poses: Array
    """(n, 3), the first one true."""
    model: SimilarityModel | None = None
    closures: int = 0
    grid: GridMap | None = None
    fingerprints: Sequence[Fingerprint] = ()
    """At the poses; empty for methods that make no radio map."""

    def errors(self) -> dict[str, float]:
        """Mean and standard deviation of position errors, and root mean square after one rigid alignment [m]."""
        away = np.linalg.norm(self.poses[:, :2] - self.truth[:, :2], axis=1)
        ate = absolute_trajectory_error_m(self.poses, self.truth)
        return {"mean_m": float(away.mean()), "std_m": float(away.std()), "ate_m": ate}


def outcomes(place: Place, seed: int, methods: Sequence[str]) -> dict[str, Outcome]:
    """Results by method; methods with laser only at places that have one."""
    methods = [method for method in methods if place.has_lidar or method not in WITH_LIDAR]
    needed = {METHODS[method][0] for method in methods} - {""}
    walks = {kind: record(place, kind, seed) for kind in sorted(needed | {"wifi"})}
    return {method: METHODS[method][1](place, walks[METHODS[method][0] or "wifi"], seed) for method in methods}


def means(errors: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means of `Outcome.errors` over walks."""
    names = {"error_mean_m": "mean_m", "error_std_m": "std_m", "ate_m": "ate_m"}
    return {name: float(np.mean([error[key] for error in errors])) for name, key in names.items()}


def odometry(_place: Place, walk: RecordedWalk, _seed: int) -> Outcome:
    """Dead reckoning."""
    return Outcome(walk.true_poses, walk.odometry)


def radio(
    weighting: str, false_share: float = 0.0, similarity: str = "shifted"
) -> Callable[[Place, RecordedWalk, int], Outcome]:
    """Radio SLAM with this weighting, share of false closures, and representation of strengths (papers.md R4)."""
    config = RadioSlamConfig(weighting=weighting, similarity=similarity)

    def run(_place: Place, walk: RecordedWalk, seed: int) -> Outcome:
        clean = _clean(walk, config)
        if not false_share:
            return clean
        count = round(clean.closures * false_share / (1 - false_share))
        return _solved(walk, config, _false_closures(walk, count, seed))

    return run


@functools.lru_cache(maxsize=2)
def _clean(walk: RecordedWalk, config: RadioSlamConfig) -> Outcome:
    return _solved(walk, config)


def _solved(walk: RecordedWalk, config: RadioSlamConfig, false_closures: Distances | None = None) -> Outcome:
    log = radio_slam.RadioLog(walk.motions, walk.turned_rad, walk.fingerprints)
    result = radio_slam.solve(log, config, false_closures=false_closures)
    model = next(iter(result.models.values()), None)
    poses = compose(walk.true_poses[0], result.poses)
    return Outcome(walk.true_poses, poses, model, len(result.closures), fingerprints=walk.fingerprints)


def location_errors_m(outcome: Outcome) -> dict[str, float]:
    """Mean error of places found for other scans in the radio map of an outcome (papers.md R10), by method [m].

    At most `MAP_PLACES_MAX` scans of the walk make the map, at their estimated poses; scans between them are located.
    """
    every = max(2, math.ceil(len(outcome.poses) / MAP_PLACES_MAX))
    kept, asked = slice(0, None, every), slice(every // 2, None, every)
    radio_map = RadioMap(outcome.poses[kept, :2], outcome.fingerprints[kept])
    process = GaussianProcessMap(radio_map)
    scans, true_m = outcome.fingerprints[asked], outcome.truth[asked, :2]
    found_m = {
        "nearest neighbours": [radio_map.nearest(scan) for scan in scans],
        "Gaussian process": [process.locate(scan)[0] for scan in scans],
    }
    return {name: float(np.linalg.norm(own - true_m, axis=1).mean()) for name, own in found_m.items()}


def _false_closures(walk: RecordedWalk, count: int, seed: int) -> Distances:
    random = np.random.default_rng([seed, count])
    pairs: list[tuple[int, int]] = []
    while len(pairs) < count:
        a, b = random.integers(0, len(walk.true_poses), 2).tolist()
        if np.linalg.norm(walk.true_poses[a, :2] - walk.true_poses[b, :2]) > 4 * FALSE_DISTANCE_M:
            pairs.append((min(a, b), max(a, b)))
    claimed = np.full(count, FALSE_DISTANCE_M), np.full(count, FALSE_VARIANCE_M2)
    return Distances(np.array(pairs, np.int64).reshape(-1, 2), *claimed)


def with_lidar(place: Place, walk: RecordedWalk, seed: int, config: EnvConfig = CONFIG) -> Outcome:
    """Radio SLAM, then scan matching where the path returns to itself."""
    keyframes, truth = keyframes_of(place, walk, seed)
    result = radio_lidar.solve(keyframes, config)
    return Outcome(truth, compose(truth[0], result.poses), grid=result.grid)


def gmapping(place: Place, walk: RecordedWalk, seed: int) -> Outcome:
    """The particle filter on the odometry of the walk and a laser scan at each radio scan."""
    plan = load_map(place.twin)
    ranges = radio_walks.scan_lidar(plan, LIDAR, walk.true_poses, seed)[:, ::PARTICLE_STRIDE]
    frames = [
        SensorFrame(0, k, k * radio_walks.SCAN_PERIOD_S, motion, 0.0, ranges[k])
        for k, motion in enumerate(np.concatenate([np.zeros((1, 3)), walk.motions]))
    ]
    reach_m = float(np.hypot(*(plan.bounds_m[2:] - plan.bounds_m[:2]))) + LIDAR.range_max_m
    rule = ParticleFilterSettings(size_m=2 * reach_m, cell_m=PARTICLE_CELL_M)
    settings = dataclasses.replace(rule, correlation=rule.correlation / PARTICLE_STRIDE)
    path, _ = map_frames(frames, settings, LIDAR.range_max_m, seed)
    return Outcome(walk.true_poses, compose(walk.true_poses[0], path))


def keyframes_of(place: Place, walk: RecordedWalk, seed: int):
    """Keyframes of the engine's front end on a walk with laser, and their true poses (keyframes, 3)."""
    true_poses = true_path(place, seed)
    ranges = radio_walks.scan_lidar(load_map(place.twin), LIDAR, true_poses, seed)
    odometry = radio_walks.odometry_of(walk.drift, walk.odometry_stream)
    front_end, every = FrontEnds(CONFIG, 1), radio_walks.STEPS_PER_SCAN
    keyframes, truth = [], []
    for step, pose in enumerate(true_poses):
        motion, turn_rate = np.zeros((1, 3)), np.zeros(1)
        if step:
            motion, turn_rate = odometry.measure(true_poses[step - 1][None], pose[None])
        heard = walk.fingerprints[step // every] if step % every == 0 else None
        scan = WifiScan(heard.macs, heard.rssi_dbm) if heard is not None else None
        time_s = step * radio_walks.ODOMETRY_STEP_S
        frame = SensorFrame(0, step, time_s, motion[0].copy(), float(turn_rate[0]), ranges[step], scan)
        for keyframe in front_end.update([frame]):
            keyframes.append(keyframe)
            truth.append(pose)
    return keyframes, np.array(truth)


METHODS: dict[str, tuple[str, Callable[[Place, RecordedWalk, int], Outcome]]] = {
    "odometry": ("", odometry),
    "wifi": ("wifi", radio("ours")),
    "wifi paper": ("wifi", radio("paper")),
    "wifi raw dBm": ("wifi", radio("ours", similarity="raw")),
    "wifi linear": ("wifi", radio("ours", similarity="linear")),
    "wifi false 2 %": ("wifi", radio("ours", 0.02)),
    "wifi false 20 %": ("wifi", radio("ours", 0.2)),
    ONE_BAND: (ONE_BAND, radio("ours")),
    "lte": ("lte", radio("ours")),
    "lte paper": ("lte", radio("paper")),
    "wifi+lidar": ("wifi", with_lidar),
    "wifi+lidar paper": ("wifi", functools.partial(with_lidar, config=PRINTED_RULE)),
    "gmapping": ("", gmapping),
}
"""Name -> the radio it uses ("" for none), and its function."""
WITH_LIDAR = ("wifi+lidar", "wifi+lidar paper", "gmapping")
