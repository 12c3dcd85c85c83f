"""Message exchange and its cost in bytes: keyframes are forwarded until every mapper has them (store and forward).

Keyframes of a robot are delivered in order, so one count per robot describes what a mapper holds. With
`scan_on_request` a keyframe is sent without its scan, which only mappers get that request it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from twc_env.config import EnvConfig
from twc_env.records.messages import Contacts, Keyframe

BYTES_PER_BEAM = 2
BYTES_PER_FINGERPRINT_MAC = 7
"""Six bytes of address, one of RSSI."""
BYTES_PER_POSE = 12
BYTES_PER_COVARIANCE = 12
"""Six half-precision numbers."""
BYTES_PER_SCALE = 8
"""Four half-precision numbers: motion by odometry alone (2), odometry scale and its standard deviation."""
BYTES_PER_REQUEST = 4
"""Robot and index of the keyframe whose scan is requested."""
BYTES_PER_COUNT = 2
"""One entry of the inventory: the number of keyframes held of one robot."""

RELEASE_FROM = 64
"""With more stored keyframes of a robot, those that all mappers hold are released whenever a new one is added."""

KINDS = ("pose", "text", "fingerprint", "scan", "request", "inventory")


@dataclass(slots=True)
class Delivery:
    """What one mapper receives in one step."""

    keyframes: list[Keyframe] = field(default_factory=list)
    scans: list[tuple[int, int]] = field(default_factory=list)
    """(robot, keyframe index) of requested scans."""


_EMPTY = [Delivery()]
"""Empty delivery to the central mapper; never modified."""


class Exchange:
    """Turns contacts into deliveries; knows which mapper holds which keyframes and scans.

    Lost messages are repeated and counted again.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        self._on_request = config.link.scan_on_request
        self._is_central = config.link.topology == "central"
        mappers = 1 if self._is_central else robot_count
        self._beam_count = config.lidar.circle_beam_count
        self._paths: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        """Of each robot: stored keyframes, which some mapper may still lack ..."""
        self._released = [0] * robot_count
        """... and the number of earlier ones, which all mappers hold."""
        self._ends = [0] * robot_count
        """Number of keyframes created by each robot."""
        self._created_count = 0
        """Number of keyframes created by all robots ..."""
        self._received_count = 0
        """... and number delivered, summed over the mappers."""
        self._held = [[0] * robot_count for _ in range(mappers)]
        """[mapper][robot]: number of keyframes of the robot that the mapper holds."""
        self._scans: list[set[tuple[int, int]]] = [set() for _ in range(mappers)]
        """Requested scans that each mapper has received."""
        self._announced: list[list[list[int]]] = [[[] for _ in range(mappers)] for _ in range(mappers)]
        """[listener][sender]: the listener's `_held` as last announced to the sender."""
        self._pairs_of: Contacts | None = None
        self._pairs: list[tuple[int, int, bool]] = []
        """(listener, sender, whether the message is received) of every pair in contact, for `_pairs_of`."""
        self.bytes_sent = dict.fromkeys(KINDS, 0)
        """Message type -> bytes transmitted so far, repetitions included."""

    def add(self, keyframe: Keyframe) -> None:
        """Store a new keyframe of a robot."""
        path = self._paths[keyframe.robot]
        if len(path) >= RELEASE_FROM:
            self._release(keyframe.robot)
        path.append(keyframe)
        self._ends[keyframe.robot] += 1
        self._created_count += 1

    def deliver(self, contacts: Contacts, wanted: Sequence[Collection[tuple[int, int]]]) -> list[Delivery]:
        """Deliveries of one step to each mapper; wanted: the scans that each mapper requests.

        A keyframe travels one hop per step. If several senders hold what a listener lacks, the first one sends it.
        """
        if self._is_central and self._created_count == self._received_count and not wanted[0]:
            return _EMPTY
        if contacts is not self._pairs_of:
            self._pairs_of = contacts
            self._pairs = [(i, k, bool(contacts.heard[i, k])) for i, k in np.argwhere(contacts.tried).tolist()]
        return [self._deliver_to_one(wanted[0])] if self._is_central else self._deliver_to_each(wanted)

    def _deliver_to_one(self, wanted: Collection[tuple[int, int]]) -> Delivery:
        """Delivery to the central mapper, directly from the robots."""
        delivery, held, ends = Delivery(), self._held[0], self._ends
        for _, sender, is_heard in self._pairs:
            if held[sender] < ends[sender]:
                self._send_keyframes(delivery, 0, sender, ends[sender], is_heard)
            if wanted:
                self._send_scans(delivery, 0, sender, wanted, is_heard)
        return delivery

    def _deliver_to_each(self, wanted: Sequence[Collection[tuple[int, int]]]) -> list[Delivery]:
        """Deliveries to the mappers on the robots."""
        deliveries = [Delivery() for _ in self._held]
        for robot, delivery in enumerate(deliveries):  # its own keyframes, without transmission
            if self._held[robot][robot] < self._ends[robot]:
                self._receive(delivery, robot, robot, self._missing(robot, robot, self._ends[robot]))
        before = [held.copy() for held in self._held]
        for listener, sender, is_heard in self._pairs:
            self._send_inventory(listener, sender, is_heard)
            for robot, count in enumerate(before[sender]):
                end = self._ends[robot] if robot == sender else count
                if self._held[listener][robot] < end:
                    self._send_keyframes(deliveries[listener], listener, robot, end, is_heard)
            if wanted[listener]:
                self._send_scans(deliveries[listener], listener, sender, wanted[listener], is_heard)
        return deliveries

    def _send_inventory(self, listener: int, sender: int, is_heard: bool) -> None:
        """The listener announces its inventory to the sender if it has changed since the last time."""
        if self._announced[listener][sender] == self._held[listener]:
            return
        self.bytes_sent["inventory"] += BYTES_PER_COUNT * len(self._paths)
        if is_heard:
            self._announced[listener][sender] = self._held[listener].copy()

    def _send_keyframes(self, delivery: Delivery, listener: int, robot: int, end: int, is_heard: bool) -> None:
        """Send the keyframes of a robot before index `end` that the listener lacks."""
        missing = self._missing(listener, robot, end)
        for keyframe in missing:
            self._add_bytes(keyframe)
        if is_heard:
            self._receive(delivery, listener, robot, missing)

    def _receive(self, delivery: Delivery, listener: int, robot: int, missing: list[Keyframe]) -> None:
        delivery.keyframes += missing
        self._held[listener][robot] += len(missing)
        self._received_count += len(missing)

    def _missing(self, listener: int, robot: int, end: int) -> list[Keyframe]:
        """Keyframes of a robot before index `end` that the listener does not hold."""
        released = self._released[robot]
        return self._paths[robot][self._held[listener][robot] - released : end - released]

    def _release(self, robot: int) -> None:
        """Delete the keyframes of a robot that all mappers hold."""
        known = min(held[robot] for held in self._held)
        del self._paths[robot][: known - self._released[robot]]
        self._released[robot] = known

    def _send_scans(self, delivery: Delivery, listener: int, sender: int, wanted, is_heard: bool) -> None:
        """Request the wanted scans that the sender holds, and send them."""
        for key in wanted:
            robot, _ = key
            has_it = robot == sender or (not self._is_central and key in self._scans[sender])
            if not has_it or key in self._scans[listener]:
                continue
            self.bytes_sent["request"] += BYTES_PER_REQUEST
            self.bytes_sent["scan"] += BYTES_PER_BEAM * self._beam_count
            if is_heard:
                self._scans[listener].add(key)
                delivery.scans.append(key)

    def _add_bytes(self, keyframe: Keyframe) -> None:
        """Add the size of a keyframe message to `bytes_sent`."""
        sent = self.bytes_sent
        sent["pose"] += BYTES_PER_POSE + BYTES_PER_COVARIANCE
        if keyframe.odometry_scale != (0.0, 0.0):
            sent["pose"] += BYTES_PER_SCALE
        for sign in keyframe.signs:
            sent["text"] += len(sign.text.encode()) + BYTES_PER_POSE
        sent["fingerprint"] += BYTES_PER_FINGERPRINT_MAC * len(keyframe.fingerprint.macs)
        if not self._on_request:
            sent["scan"] += BYTES_PER_BEAM * len(keyframe.ranges_m)
