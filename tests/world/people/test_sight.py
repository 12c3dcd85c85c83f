"""People in front of scanners, access points and signs."""

import math

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.records.messages import UNSEEN_M
from twc_env.world.people.sight import shorten
from twc_env.world.world import World

BEAMS, RANGE_MAX_M = 360, 10.0
ANGLES = 2 * math.pi * np.arange(BEAMS) / BEAMS
DIRECTIONS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])


def seen(disc, ranges=RANGE_MAX_M, pose=(0.0, 0.0, 0.0), std=0.0, numbers=BEAMS):
    out = np.full((1, BEAMS), ranges) if np.isscalar(ranges) else ranges[None].copy()
    used, end = np.zeros(1, np.int64), np.array([numbers])
    noise = np.ones((1, BEAMS))
    done = shorten(np.array([disc]), np.array([pose]), DIRECTIONS, RANGE_MAX_M, std, noise, used, end, out)
    return out[0], done, int(used[0])


def test_the_beam_at_a_leg_ends_a_radius_before_its_middle_and_beams_beside_it_do_not():
    ranges, _, _ = seen((2.0, 0.0, 0.06))
    assert ranges[0] == pytest.approx(1.94) and ranges[BEAMS // 4] == RANGE_MAX_M
    half_deg = math.degrees(math.asin(0.06 / 2.0))
    assert np.count_nonzero(ranges < RANGE_MAX_M) == 2 * math.floor(half_deg) + 1


def test_a_leg_behind_a_wall_or_in_a_blind_sector_is_not_seen():
    for ranges in (np.full(BEAMS, 1.0), np.full(BEAMS, UNSEEN_M)):
        assert np.array_equal(seen((2.0, 0.0, 0.06), ranges)[0], ranges)


def test_legs_turn_with_the_robot():
    assert seen((0.0, 2.0, 0.06), pose=(0.0, 0.0, math.pi / 2))[0][0] == pytest.approx(1.94)


def test_noise_is_drawn_for_hit_beams_only_and_nothing_happens_without_enough_of_it():
    ranges, done, used = seen((2.0, 0.0, 0.06), std=0.01)
    assert done and used == np.count_nonzero(ranges < RANGE_MAX_M) and ranges[0] == pytest.approx(1.95)
    ranges, done, used = seen((2.0, 0.0, 0.06), numbers=BEAMS - 1)
    assert not done and (ranges == RANGE_MAX_M).all()


def world_with(kind: str) -> World:
    """One robot, and one person who stands or sits."""
    shares = {"people.walking_share": 0.0, "people.sitting_share": float(kind == "sit")}
    quiet = {f"radio.{name}_std_db": 0.0 for name in ("noise", "fading", "shadowing", "device_offset")}
    config = override(EnvConfig(), {"map": "twin-01", "robots": 1, "people.count": 1, **shares, **quiet})
    return World(config, load_map("twin-01"))


def sign_ahead():
    """A sign of the building, and the pose (3,) from which it is 1.5 m straight ahead."""
    plan = load_map("twin-01").home
    for sign in plan.signs:
        normal = np.array([math.cos(sign.facing_rad), math.sin(sign.facing_rad)])
        place = sign.position_m + 1.5 * normal
        line = sign.position_m + np.linspace(0.3, 1.5, 7)[:, None] * normal
        if (plan.wall_index.distance_m(line, 0.5) > 0.25).all() and plan.cells().is_free(place):
            return sign, np.array([*place, math.remainder(sign.facing_rad + math.pi, 2 * math.pi)])
    raise AssertionError("no sign has open floor in front")


@pytest.mark.parametrize(("kind", "is_read"), [("stand", False), ("sit", True)])
def test_a_standing_person_hides_a_sign_and_a_sitting_one_does_not(kind, is_read):
    sign, pose = sign_ahead()
    world = world_with(kind)
    world.reset(0, pose[None])
    between = 0.5 * (sign.position_m + pose[:2])
    world.crowd._state[0, :2] = world.crowd.hiding[:, :2] = between
    world.crowd.step = lambda poses, commands: commands  # nobody steps aside
    texts = [reading for _ in range(40) for reading in world.tick(np.zeros((1, 2))).signs[0]]
    assert bool(texts) is is_read


def test_the_scanner_sees_legs_of_the_person_in_front():
    _, pose = sign_ahead()
    world = world_with("stand")
    world.reset(0, pose[None])
    world.crowd._state[0, :2] = world.crowd._state[0, 8:10] = pose[:2] + 0.8 * np.array(
        [math.cos(pose[2]), math.sin(pose[2])]
    )
    with_person = world.tick(np.zeros((1, 2))).ranges_m[0]
    clean = World(override(world.config, {"people.count": 0}), load_map("twin-01"))
    clean.reset(0, pose[None])
    bare = clean.tick(np.zeros((1, 2))).ranges_m[0]
    changed = np.abs(with_person - bare) > 0.2
    assert 4 <= changed.sum() <= 20 and with_person[changed].min() > 0.6
