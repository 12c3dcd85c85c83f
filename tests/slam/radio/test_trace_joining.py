import numpy as np
import pytest

from twc_env.config import RadioSlamConfig
from twc_env.errors import DataError
from twc_env.records.geometry import align_rigidly, compose, transform_points
from twc_env.records.messages import Fingerprint
from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio.radio_field import FieldConstraints
from twc_env.slam.radio.trace_joining import Trace, _Joiner, join

BOXES = np.random.default_rng(0).uniform(-10, 70, (120, 2))


def walks(count: int = 25, seed: int = 0) -> tuple[list[Trace], list[np.ndarray]]:
    """Straight traces through a hall of 60 x 60 m, with heading errors of 0.1 rad (standard deviation)."""
    random = np.random.default_rng(seed)
    traces, truths = [], []
    for _ in range(count):
        start, end = random.uniform(0, 60, (2, 2))
        steps = max(6, int(np.linalg.norm(end - start) / 1.5))
        places = start + np.linspace(0, 1, steps)[:, None] * (end - start)
        level = -35 - 28 * np.log10(np.maximum(np.linalg.norm(places[:, None] - BOXES[None], axis=2), 1.0))
        level += 2.0 * random.normal(size=level.shape)
        macs = np.arange(len(BOXES), dtype=np.int64)
        prints = [Fingerprint(macs[row > -80], row[row > -80]) for row in level]
        turned = compose([0.0, 0.0, 0.1 * random.normal()], np.column_stack([places - start, np.zeros(steps)]))
        traces.append(Trace(turned, prints))
        truths.append(places)
    return traces, truths


def test_traces_are_joined_by_fingerprints_alone():
    traces, truths = walks()
    joined = join(traces, RadioSlamConfig())
    assert joined.is_joined.all()
    found, truth = np.concatenate(joined.positions_m), np.concatenate(truths)
    away = transform_points(align_rigidly(found, truth), found) - truth
    assert np.linalg.norm(away, axis=1).mean() < 2.5


@pytest.mark.parametrize("weighting", ["ours", "paper"])
def test_the_gradient_by_poses_of_traces_matches_finite_differences(weighting):
    traces, _ = walks(4)
    joiner, random = _Joiner(traces, RadioSlamConfig(weighting=weighting)), np.random.default_rng(0)
    ends = [np.cumsum([0, *(len(trace.poses) for trace in traces)])[k] + random.integers(0, 5, 9) for k in (0, 1, 2, 3)]
    pairs = np.concatenate([np.column_stack([ends[a], ends[b]]) for a, b in ((0, 1), (1, 2), (3, 0))])
    root = random.normal(size=(len(pairs), 2, 2))
    pulls = [
        Distances(pairs, random.uniform(1.0, 9.0, len(pairs)), random.uniform(1.0, 9.0, len(pairs))),
        FieldConstraints(
            pairs, random.normal(0.0, 3.0, (len(pairs), 2)), root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
        ),
    ]
    poses = np.column_stack([random.normal(0.0, 4.0, (4, 2)), random.normal(0.0, 0.3, 4)])
    for pull in pulls:
        _, gradient = joiner._linearise(poses, pull)
        for k in range(12):
            step = 1e-5 * np.eye(12)[k].reshape(4, 3)
            slope = (joiner._cost(poses + step, pull) - joiner._cost(poses - step, pull)) / 4e-5
            assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_a_trace_without_known_transmitters_is_left_out():
    traces, _ = walks(8)
    stranger = Trace(traces[0].poses, [Fingerprint(f.macs + 1000, f.rssi_dbm) for f in traces[0].fingerprints])
    joined = join([*traces, stranger], RadioSlamConfig())
    assert joined.is_joined.tolist() == [True] * 8 + [False]
    assert joined.group.tolist() == [0] * 8 + [1]


def test_the_map_keeps_its_scale():
    traces, truths = walks(seed=1)
    joined = join(traces, RadioSlamConfig())
    found, truth = np.concatenate(joined.positions_m), np.concatenate(truths)
    spread = [np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean()) for p in (found, truth)]
    assert abs(spread[0] / spread[1] - 1.0) < 0.04


def test_a_trace_without_scans_is_left_out():
    traces, _ = walks(8)
    silent = Trace(np.zeros((0, 3)), [])
    joined = join([*traces[:4], silent, *traces[4:]], RadioSlamConfig())
    assert joined.is_joined.tolist() == [True] * 4 + [False] + [True] * 4


@pytest.mark.parametrize("poses", [np.zeros((2, 3)), np.full((1, 3), np.nan), np.zeros((1, 2))])
def test_a_trace_with_parts_of_unequal_length_is_rejected(poses):
    with pytest.raises(DataError, match="walk"):
        Trace(poses, [Fingerprint(np.array([1]), np.array([-50.0]))])


@pytest.mark.parametrize("count", [1, 2])
def test_traces_too_short_for_a_distance_model_are_rejected_if_it_is_requested(count):
    traces = [Trace(np.array([[0.0, 0, 0], [1.0, 0, 0]]), [Fingerprint(np.array([1]), np.array([-50.0]))] * 2)] * count
    with pytest.raises(DataError, match="too few pairs"):
        join(traces, RadioSlamConfig(weighting="paper"))
    assert join(traces, RadioSlamConfig()).is_joined.all()


@pytest.mark.parametrize("traces", [[], [Trace(np.zeros((0, 3)), [])]])
def test_traces_without_any_scan_are_rejected(traces):
    with pytest.raises(DataError, match="nothing to join"):
        join(traces, RadioSlamConfig())
