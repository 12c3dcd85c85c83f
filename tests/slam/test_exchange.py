import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.messages import Contacts
from twc_env.slam.exchange import Exchange

NOTHING = [(), (), ()]


def contacts(*pairs: tuple[int, int], listeners: int = 3, lost: bool = False) -> Contacts:
    """Contacts of three robots from pairs (listener, sender)."""
    tried = np.zeros((listeners, 3), bool)
    for pair in pairs:
        tried[pair] = True
    return Contacts(tried, tried & (not lost))


def exchange(**link) -> Exchange:
    return Exchange(override(EnvConfig(), {f"link.{key}": value for key, value in link.items()}), 3)


def names(delivery) -> list[tuple[int, int]]:
    return [(k.robot, k.index) for k in delivery.keyframes]


def test_a_keyframe_is_forwarded_to_robots_that_its_owner_never_met(keyframe):
    radio = exchange(topology="peer")
    radio.add(keyframe(robot=0))
    between_0_and_1, between_1_and_2 = contacts((0, 1), (1, 0)), contacts((1, 2), (2, 1))
    assert [names(d) for d in radio.deliver(between_0_and_1, NOTHING)] == [[(0, 0)], [(0, 0)], []]
    assert [names(d) for d in radio.deliver(between_1_and_2, NOTHING)] == [[], [], [(0, 0)]]
    assert all(names(d) == [] for d in radio.deliver(between_1_and_2, NOTHING))


def test_a_keyframe_travels_one_hop_per_step(keyframe):
    radio = exchange(topology="peer")
    radio.add(keyframe(robot=0))
    chain = contacts((1, 0), (2, 1))
    assert [names(d) for d in radio.deliver(chain, NOTHING)] == [[(0, 0)], [(0, 0)], []]
    assert names(radio.deliver(chain, NOTHING)[2]) == [(0, 0)]


def test_each_mapper_gets_every_keyframe_once_and_in_order(keyframe):
    radio = exchange(topology="peer", scan_on_request=True)
    random = np.random.default_rng(3)
    got = [[], [], []]
    for step in range(60):
        if step < 40:
            radio.add(keyframe(robot=step % 3, index=step // 3))
        tried = random.random((3, 3)) < 0.3
        np.fill_diagonal(tried, False)
        for mine, delivery in zip(
            got, radio.deliver(Contacts(tried, tried & (random.random((3, 3)) < 0.5)), NOTHING), strict=True
        ):
            mine += names(delivery)
    for _ in range(2):
        for mine, delivery in zip(got, radio.deliver(contacts((0, 1), (1, 2), (2, 0)), NOTHING), strict=True):
            mine += names(delivery)
    for mine in got:
        for robot in range(3):
            assert [k for k in mine if k[0] == robot] == [(robot, i) for i in range(len(range(robot, 40, 3)))]


def test_bytes_are_counted_by_kind_and_counted_again_when_lost(keyframe):
    radio = exchange()
    radio.add(keyframe(robot=1, macs=(1, 2, 3), rssi_dbm=(-50, -60, -70), ranges_m=np.ones(180)))
    up = contacts((0, 1), listeners=1)
    lost = contacts((0, 1), listeners=1, lost=True)
    assert names(radio.deliver(lost, [()])[0]) == []
    once = dict(radio.bytes_sent)
    assert once == {"pose": 24, "text": 0, "fingerprint": 21, "scan": 360, "request": 0, "inventory": 0}
    assert names(radio.deliver(up, [()])[0]) == [(1, 0)]
    assert radio.bytes_sent == {kind: 2 * count for kind, count in once.items()}
    radio.deliver(up, [()])
    assert radio.bytes_sent["scan"] == 720


def test_scans_are_sent_only_on_request(keyframe):
    radio = exchange(topology="peer", scan_on_request=True)
    radio.add(keyframe(robot=0, ranges_m=np.ones(180)))
    everyone = contacts((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
    assert names(radio.deliver(everyone, NOTHING)[1]) == [(0, 0)]
    assert radio.bytes_sent["scan"] == 0
    deliveries = radio.deliver(everyone, [(), [(0, 0)], ()])
    assert [d.scans for d in deliveries] == [[], [(0, 0)], []]
    assert (radio.bytes_sent["scan"], radio.bytes_sent["request"]) == (360, 4)
    assert radio.deliver(contacts((2, 1)), [(), (), [(0, 0)]])[2].scans == [(0, 0)], "robot 1 carries it now"


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_without_contacts_no_bytes_are_sent(keyframe, topology):
    radio = exchange(topology=topology)
    radio.add(keyframe(robot=0))
    listeners = 1 if topology == "central" else 3
    radio.deliver(contacts(listeners=listeners), [()] * listeners)
    assert sum(radio.bytes_sent.values()) == 0


def test_messages_held_by_all_are_dropped_and_absent_robots_get_the_rest(keyframe):
    radio, got = exchange(topology="peer"), []
    for index in range(500):
        radio.add(keyframe(robot=0, index=index))
        pairs = ((1, 0), (2, 0)) if index < 300 else ((1, 0),)
        got += names(radio.deliver(contacts(*pairs), NOTHING)[2])
    assert len(radio._paths[0]) == 200
    got += names(radio.deliver(contacts((2, 1)), NOTHING)[2])
    assert got == [(0, index) for index in range(500)]
    radio.add(keyframe(robot=0, index=500))
    assert len(radio._paths[0]) == 1
