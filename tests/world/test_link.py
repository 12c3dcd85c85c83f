import numpy as np
import pytest

from twc_env.config import LinkConfig
from twc_env.world.building.wall_index import index_walls
from twc_env.world.link import Link

IN_A_ROW = np.array([[0.0, 0.0], [4.0, 0.0], [9.0, 0.0]])


def link(robots: int = 3, seed: int = 0, walls_m=((2.0, -1.0), (2.0, 1.0)), **settings) -> Link:
    walls = index_walls(np.array([walls_m]), np.array([4.0]))
    return Link(LinkConfig(**settings), robots, walls, np.random.default_rng(seed))


def test_the_central_mapper_is_always_in_range():
    contacts = link().contacts(1e6 * IN_A_ROW)
    assert contacts.tried.shape == (1, 3)
    assert contacts.tried.all() and contacts.heard.all()


def test_peers_hear_each_other_up_to_the_range_and_never_themselves():
    contacts = link(topology="peer", range_max_m=5.0).contacts(IN_A_ROW)
    assert contacts.tried.astype(int).tolist() == [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    assert np.array_equal(contacts.tried, contacts.heard)


def test_a_wall_shortens_the_range_of_those_it_stands_between():
    contacts = link(topology="peer", range_max_m=5.0, wall_range_m=2.0).contacts(IN_A_ROW)
    assert contacts.tried.astype(int).tolist() == [[0, 0, 0], [0, 0, 1], [0, 1, 0]]


def test_lost_messages_count_as_tried():
    channel = link(loss_probability=0.3, seed=1)
    heard = np.array([channel.contacts(IN_A_ROW).heard for _ in range(2000)])
    assert heard.mean() == pytest.approx(0.7, abs=0.02)
    assert channel.contacts(IN_A_ROW).tried.all()


def test_equal_seeds_lose_the_same_messages():
    first, second = (link(topology="peer", loss_probability=0.5, seed=7) for _ in range(2))
    for _ in range(50):
        assert np.array_equal(first.contacts(IN_A_ROW).heard, second.contacts(IN_A_ROW).heard)
