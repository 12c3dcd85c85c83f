import numpy as np
import pytest

from twc_env.config import LinkConfig
from twc_env.world.link import Link


def link(loss: float, robots: int = 2, seed: int = 0) -> Link:
    return Link(LinkConfig(loss_probability=loss), robots, np.random.default_rng(seed))


def test_a_sound_link_delivers_all_at_once_in_order():
    channel = link(0.0)
    for number in range(3):
        channel.send(1, "keyframe", f"b{number}", 10)
    channel.send(0, "text", "a0", 4)
    assert channel.deliver() == ["a0", "b0", "b1", "b2"]
    assert channel.deliver() == []
    assert channel.bytes_sent == {"text": 4, "keyframe": 30}


def test_a_lossy_link_loses_nothing_for_good_and_keeps_each_robots_order():
    channel = link(0.6, seed=1)
    arrived = []
    for step in range(200):
        if step < 50:
            for robot in (0, 1):
                channel.send(robot, "keyframe", (robot, step), 1)
        arrived += channel.deliver()
    for robot in (0, 1):
        assert [payload for payload in arrived if payload[0] == robot] == [(robot, step) for step in range(50)]


def test_what_is_sent_again_counts_again():
    channel = link(0.5, robots=1, seed=2)
    for step in range(2000):
        channel.send(0, "pose", step, 12)
        channel.deliver()
    for _ in range(3000):
        channel.deliver()
    assert channel.bytes_sent["pose"] / (12 * 2000) == pytest.approx(2.0, rel=0.08)


def test_equal_seeds_lose_the_same_messages():
    histories = []
    for _ in range(2):
        channel = link(0.5, seed=7)
        history = []
        for step in range(50):
            channel.send(0, "pose", step, 12)
            history.append(channel.deliver())
        histories.append(history)
    assert histories[0] == histories[1]
