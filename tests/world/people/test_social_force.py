import math

import numpy as np
import pytest

from twc_env.world.people.social_force import (
    RANGE_S,
    REACH_M,
    RELATIVE_MOTION,
    STRENGTH_M_S2,
    interaction,
    wall_repulsion,
)


def published(d, v):
    """Moussaid et al. 2009, Eq. 4 to 7, with n' = 3, n = 2; d (2,) to the other, v (2,) gained on them."""
    distance = np.linalg.norm(d)
    e = d / distance
    D = RELATIVE_MOTION * v + e
    t, B = D / np.linalg.norm(D), RANGE_S * np.linalg.norm(D)
    theta = (math.atan2(e[1], e[0]) - math.atan2(t[1], t[0]) + math.pi) % (2 * math.pi) - math.pi
    left = np.array([-t[1], t[0]])
    slowing = math.exp(-distance / B - (3 * B * theta) ** 2)
    turning = np.sign(theta) * math.exp(-distance / B - (2 * B * theta) ** 2)
    return -STRENGTH_M_S2 * (slowing * t + turning * left)


@pytest.mark.parametrize("case", range(30))
def test_the_interaction_is_the_published_one(case):
    random = np.random.default_rng(case)
    d, v = random.uniform(-2, 2, 2), random.uniform(-1.5, 1.5, 2)
    assert np.array(interaction(*d, *v)) == pytest.approx(published(d, v), abs=0.05)


def test_two_people_head_on_both_slow_down_and_evade_to_the_right():
    ahead, left = interaction(1.5, 0.0, 2.0, 0.0)
    reach = RANGE_S * (2 * RELATIVE_MOTION + 1)
    assert ahead == pytest.approx(-STRENGTH_M_S2 * math.exp(-1.5 / reach), rel=1e-3)
    assert left < -0.5
    assert interaction(-1.5, 0.0, -2.0, 0.0) == pytest.approx((-ahead, -left))


def test_people_far_away_are_ignored():
    assert interaction(REACH_M + 0.01, 0.0, 2.0, 0.0) == (0.0, 0.0)


def test_walls_repel_by_three_metres_per_second_squared_at_the_body_and_e_times_less_ten_centimetres_away():
    assert wall_repulsion(0.0) == pytest.approx(3.0)
    assert wall_repulsion(0.1) == pytest.approx(3.0 / math.e)
