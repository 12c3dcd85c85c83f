import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.config import MergingConfig
from twc_env.records.geometry import between, compose, inverse
from twc_env.records.growing_arrays import READINGS_ROOM
from twc_env.records.messages import Fingerprint
from twc_env.slam.merging import map_merging
from twc_env.slam.merging.map_merging import (
    LATER_M,
    count_places,
    largest_agreement,
    wall_contradiction,
    weight_of,
    wifi_difference,
)
from twc_env.slam.merging.merge_tests import RADIO_SLACK
from twc_env.slam.places.heard_places import HeardPlaces
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

TRUE_A_B = np.array([12.0, -7.0, 2.2])


def heard_at(fingerprints) -> HeardPlaces:
    places = HeardPlaces()
    places.add(fingerprints)
    return places


def closures(seed: int, count: int, noise_m: float = 0.05, pose_a_b=TRUE_A_B, spread_m: float = 8.0):
    """Targets in a, sources in b, measured poses, signs and text equality of closures that agree up to noise."""
    random = np.random.default_rng(seed)
    sources = np.column_stack([random.uniform(-spread_m, spread_m, (count, 2)), random.uniform(-3, 3, count)])
    targets = compose(compose(pose_a_b, sources), random.normal(0, 0.5, (count, 3)))
    measured = compose(between(targets, compose(pose_a_b, sources)), random.normal(0, 1, (count, 3)) * noise_m)
    signs_m = compose(pose_a_b, sources)[:, :2]
    return targets, sources, measured, signs_m, np.ones(count, bool)


def joined(*parts):
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_the_majority_is_found_among_false_closures(seed):
    random = np.random.default_rng(seed)
    lies = [
        closures(seed + i, 1, pose_a_b=np.append(random.uniform(-30, 30, 2), random.uniform(-3, 3))) for i in range(8)
    ]
    proposal = largest_agreement(*joined(closures(seed, 5), *lies), MergingConfig())
    assert proposal is not None
    assert proposal.support[:5].sum() >= 3
    assert proposal.support[5:].sum() <= 1
    error = between(TRUE_A_B, proposal.pose_a_b)
    assert np.hypot(error[0], error[1]) < 1.5
    assert abs(error[2]) < 0.25


def test_exact_closures_give_the_exact_pose():
    proposal = largest_agreement(*closures(1, 6, noise_m=0.0), MergingConfig())
    assert between(TRUE_A_B, proposal.pose_a_b) == pytest.approx(np.zeros(3), abs=1e-9)
    assert proposal.support.all()


def test_the_larger_of_two_consistent_sets_wins():
    lie = np.array([-3.0, 4.0, 0.5])
    parts = closures(2, 3, pose_a_b=lie, noise_m=0.01), closures(3, 5, noise_m=0.01)
    proposal = largest_agreement(*joined(*parts), MergingConfig())
    assert proposal.support.tolist() == [False] * 3 + [True] * 5


def test_three_signs_outweigh_two_with_more_readings():
    lie = np.array([-3.0, 4.0, 0.5])
    targets, sources, measured, signs, alike = closures(2, 6, pose_a_b=lie, noise_m=0.01)
    seen_again = targets, sources, measured, np.tile([[0.0, 0.0], [4.0, 0.0]], (3, 1)), alike
    proposal = largest_agreement(*joined(seen_again, closures(3, 3, noise_m=0.01)), MergingConfig())
    assert proposal.support.tolist() == [False] * 6 + [True] * 3
    assert proposal.weight == (3, 3, 3)
    other = largest_agreement(
        *joined((targets, sources, measured, signs, alike), closures(3, 3, noise_m=0.01)), MergingConfig()
    )
    assert other.support.tolist() == [True] * 6 + [False] * 3


def test_an_equal_text_outweighs_rows_of_similar_texts():
    lie = np.array([-3.0, 4.0, 0.5])
    *shifted, _ = closures(2, 6, pose_a_b=lie, noise_m=0.01)
    next_door = *shifted, np.zeros(6, bool)
    true = *closures(3, 3, noise_m=0.01)[:4], np.array([True, False, False])
    proposal = largest_agreement(*joined(next_door, true), MergingConfig())
    assert proposal.support.tolist() == [False] * 6 + [True] * 3
    assert proposal.weight == (1, 3, 3)
    assert largest_agreement(*next_door, MergingConfig()) is None
    assert largest_agreement(*next_door, MergingConfig(signs_read_alike_min=0)).weight == (0, 6, 6)
    assert largest_agreement(*true, MergingConfig(signs_read_alike_min=2)) is None


@pytest.mark.parametrize(("apart_m", "count"), [(0.0, 4), (0.5, 3), (1.5, 2), (9.0, 1)])
def test_signs_closer_than_the_spread_count_once(apart_m, count):
    signs_m = np.array([[9.0, 9.0], [0.0, 0.0], [0.1, 0.0], [1.0, 0.0], [3.0, 0.0]])
    assert count_places(signs_m, np.arange(1, 5), apart_m) == count
    assert count_places(signs_m, np.arange(0), apart_m) == 0


def by_the_definition(targets, sources, measured, signs_m, is_read_alike, rule: MergingConfig):
    """Largest weight and its set of closures, from all pairs with array functions."""
    poses_a_b = compose(compose(targets, measured), inverse(sources))
    error = between(compose(targets, measured)[None], compose(poses_a_b[:, None], sources[None]))
    apart = np.linalg.norm(sources[:, None, :2] - sources[None, :, :2], axis=2)
    agrees = np.linalg.norm(error[..., :2], axis=2) <= rule.consistency_m + 0.02 * apart
    agrees &= np.abs(error[..., 2]) <= rule.consistency_rad
    found = ((0, 0, 0), None, None)
    for row in agrees:
        spread = np.linalg.norm(signs_m[row][:, None] - signs_m[row][None], axis=2).max()
        weight = weight_of(signs_m[row], is_read_alike[row], rule)
        if row.sum() >= rule.closures_min and spread >= rule.spread_min_m and weight > found[0]:
            cost = np.where(row, np.linalg.norm(error[..., :2], axis=2), 0.0).sum(axis=1)
            found = weight, row, poses_a_b[np.flatnonzero(row)[np.argmin(cost[row])]]
    return found


@pytest.mark.parametrize("seed", range(40))
def test_the_agreement_has_the_largest_weight_of_all_sets(seed):
    random = np.random.default_rng(seed)
    rule = MergingConfig(signs_read_alike_min=0, spread_min_m=float(random.choice([0.0, 0.5, 1.5])))
    parts = [
        closures(100 * seed + k, int(random.integers(1, 12)), random.uniform(0.01, 0.4), random.uniform(-3, 3, 3), 2.0)
        for k in range(6)
    ]
    *parts, signs_m, alike = joined(*parts)
    alike = random.uniform(size=len(alike)) < 0.3
    weight, support, pose_a_b = by_the_definition(*parts, signs_m, alike, rule)
    proposal = largest_agreement(*parts, signs_m, alike, rule)
    if support is None:
        assert proposal is None
    else:
        assert proposal.weight == weight
        assert proposal.support.tolist() == support.tolist()
        assert proposal.pose_a_b == pytest.approx(pose_a_b)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_closures_give_no_proposal(count):
    assert largest_agreement(*closures(4, count, noise_m=0.0), MergingConfig(closures_min=3)) is None


def test_inconsistent_closures_give_no_proposal():
    random = np.random.default_rng(5)
    lies = [closures(i, 1, pose_a_b=np.append(random.uniform(-40, 40, 2), random.uniform(-3, 3))) for i in range(6)]
    assert largest_agreement(*joined(*lies), MergingConfig()) is None


def test_closures_from_signs_at_one_place_give_no_proposal():
    spot = closures(6, 6, noise_m=0.0, spread_m=0.4)
    assert largest_agreement(*spot, MergingConfig(spread_min_m=1.5)) is None
    assert largest_agreement(*spot, MergingConfig(spread_min_m=0.2)) is not None


def test_closures_by_a_single_sign_give_no_proposal():
    targets, sources, measured, _, alike = closures(6, 6, noise_m=0.0)
    one_sign = np.tile([3.0, 4.0], (6, 1))
    assert largest_agreement(targets, sources, measured, one_sign, alike, MergingConfig()) is None
    one_sign[0] = [3.0, 9.0]
    assert largest_agreement(targets, sources, measured, one_sign, alike, MergingConfig()) is not None


def test_two_places_of_a_wrong_copy_are_outweighed():
    copy = np.array([5.0, 5.0, 0.0])
    proposal = largest_agreement(
        *joined(closures(7, 2, pose_a_b=copy, noise_m=0.0), closures(8, 4, noise_m=0.0)), MergingConfig()
    )
    assert proposal.support.tolist() == [False, False, True, True, True, True]


def grid_of(room, scan, poses, frame=(0.0, 0.0, 0.0)):
    """The map of a room in a map frame with pose `frame` in the building."""
    grid = OccupancyGrid(0.1, 10.0, 360)
    local = between(np.array(frame), np.array(poses, float))
    scans = np.array([scan(room, pose, 360) for pose in poses])
    for _ in range(4):  # often enough to reach high log-odds
        grid.integrate(local, scans)
    return grid.snapshot()


POSES = [(-2.5, -1.0, 0.0), (-0.5, -0.6, 0.6), (0.0, 1.5, 1.2), (2.5, 2.0, 3.0)]


def test_identical_maps_do_not_contradict_each_other(office, scan):
    grid = grid_of(office, scan, POSES)
    assert wall_contradiction(grid, grid, np.zeros(3)) == 0.0


@pytest.mark.parametrize("frame", [(3.0, -2.0, 0.0), (1.0, 5.0, np.pi / 2), (-4.0, 2.0, 0.7)])
def test_one_room_mapped_in_two_frames_hardly_contradicts_itself(office, scan, frame):
    a, b = grid_of(office, scan, POSES), grid_of(office, scan, POSES, frame)
    assert wall_contradiction(a, b, np.array(frame)) < 0.05


@pytest.mark.parametrize("shift", [(0.0, 0.0, np.pi / 4), (1.5, 1.0, 0.0), (0.5, -0.8, 0.3)])
def test_shifted_maps_contradict_each_other(office, scan, shift):
    grid = grid_of(office, scan, POSES)
    assert wall_contradiction(grid, grid, np.array(shift)) > 0.2


def test_the_contradiction_is_symmetric(office, hall, scan):
    a, b = grid_of(office, scan, POSES), grid_of(hall, scan, [(0.0, 1.0, 0.0)])
    pose = np.array([0.4, -0.3, 0.5])
    assert wall_contradiction(a, b, pose) == pytest.approx(wall_contradiction(b, a, inverse(pose)))


def test_maps_far_apart_cannot_contradict_each_other(office, scan):
    grid = grid_of(office, scan, POSES)
    assert wall_contradiction(grid, grid, np.array([200.0, 0.0, 0.0])) == 0.0


def radio_survey(random, positions, noise_db=1.0, offset_db=0.0, shift=(0.0, 0.0)):
    """Fingerprints at these positions, with eight transmitters."""
    sources = np.random.default_rng(99).uniform(-15, 15, (8, 2))
    prints = []
    for position in positions:
        distance = np.maximum(np.linalg.norm(sources - position - np.array(shift), axis=1), 0.5)
        level = -35 - 23 * np.log10(distance) + offset_db + random.normal(0, noise_db, 8)
        prints.append(Fingerprint(np.arange(8), level))
    return prints


def wifi_hypothesis_test(claimed_shift, noise_db=1.0, offset_db=0.0, count=40):
    """Robot 1 followed the path of robot 0; the merge to check is wrong by `claimed_shift`."""
    random = np.random.default_rng(0)
    path = np.stack([np.linspace(-8, 8, count), 2 * np.sin(np.linspace(0, 6, count))], axis=1)
    travel = np.linspace(0, 18, count)
    true_b = path + np.array(claimed_shift)
    prints = radio_survey(random, path, noise_db) + radio_survey(random, true_b, noise_db, offset_db)
    positions = np.concatenate([path, path + 0.1])
    robots = np.repeat([0, 1], count)
    return wifi_difference(positions, robots, np.tile(travel, 2), heard_at(prints), np.arange(2 * count), robots == 1)


def test_radio_confirms_two_robots_on_the_same_path():
    assert wifi_hypothesis_test((0.0, 0.0)) < 0.9


def test_radio_tolerates_device_offsets():
    assert wifi_hypothesis_test((0.0, 0.0), offset_db=8.0) < 0.9


def test_radio_contradicts_if_the_second_robot_was_elsewhere():
    assert wifi_hypothesis_test((11.0, 9.0)) > RADIO_SLACK


@pytest.mark.parametrize(("claimed_shift", "is_right"), [((0.0, 0.0), True), ((11.0, 9.0), False)])
def test_radio_asks_what_a_robot_heard_when_it_came_back(claimed_shift, is_right):
    """Both robots drive to and fro, robot 1 later; each time every access point has another power."""
    random = np.random.default_rng(3)
    there = np.stack([np.linspace(-8, 8, 40), 2 * np.sin(np.linspace(0, 6, 40))], axis=1)
    path, prints = np.concatenate([there, there[::-1]]), []
    for shift in (np.zeros(2), np.array(claimed_shift)):
        for way in (there, there[::-1]):
            power_db = random.normal(0.0, 5.0, 8)
            prints += [Fingerprint(p.macs, p.rssi_dbm + power_db) for p in radio_survey(random, way + shift)]
    asked = (
        np.concatenate([path, path + 0.1]), np.repeat([0, 1], 80), np.tile(np.linspace(0, 90, 80), 2),
        heard_at(prints), np.arange(160), np.repeat([False, True], 80),
    )  # fmt: skip
    assert wifi_difference(*asked) > RADIO_SLACK
    assert (wifi_difference(*asked, LATER_M) < 1.0) is is_right


def test_radio_decides_nothing_if_the_paths_are_apart():
    random = np.random.default_rng(0)
    path = np.stack([np.linspace(-8, 8, 40), np.zeros(40)], axis=1)
    positions = np.concatenate([path, path + [0.0, 30.0]])
    robots = np.repeat([0, 1], 40)
    heard = heard_at(radio_survey(random, positions))
    travels_m = np.tile(np.linspace(0, 16, 40), 2)
    assert wifi_difference(positions, robots, travels_m, heard, np.arange(80), robots == 1) is None


def test_radio_decides_nothing_without_readings():
    empty = heard_at([Fingerprint(np.zeros(0, np.int64), np.zeros(0))] * 20)
    positions = np.tile(np.stack([np.arange(10.0), np.zeros(10)], axis=1), (2, 1))
    robots = np.repeat([0, 1], 10)
    assert wifi_difference(positions, robots, np.tile(np.arange(10.0), 2), empty, np.arange(20), robots == 1) is None


def test_places_added_one_by_one_equal_those_added_at_once():
    prints = [Fingerprint(np.arange(k), -50.0 - np.arange(k)) for k in (3, 0, 2, 4 * READINGS_ROOM)]
    at_once, grown = heard_at(prints), HeardPlaces()
    for part in (prints[:1], [], prints[1:]):
        grown.add(part)
    assert len(at_once) == 4 and at_once.starts.tolist() == [0, 3, 3, 5, 5 + 4 * READINGS_ROOM]
    assert grown.starts.tolist() == at_once.starts.tolist()
    for heard in (at_once, grown):
        for k, one in enumerate(prints):
            place = slice(heard.starts[k], heard.starts[k + 1])
            np.testing.assert_array_equal(heard.macs[place], one.macs)
            np.testing.assert_array_equal(heard.rssi_dbm[place], one.rssi_dbm)


@pytest.mark.parametrize("count", [1, 2, 5, 256])
def test_the_median_kernel_equals_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    assert map_merging._median(values) == np.median(values)
