"""What robots tell each other and what it costs: keyframes travel on until every mapper has them (store and forward).

Each mapper holds the first so many keyframes of every robot, in order; so one number per robot says what it lacks. With
`scan_on_request` a keyframe travels as its pose, texts and fingerprint, and a scan only to the mapper that asks.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from twc_env.config import EnvConfig
from twc_env.messages import Contacts, Keyframe

BYTES_PER_BEAM = 2
BYTES_PER_FINGERPRINT_MAC = 7
"""Six bytes of address and one of strength."""
BYTES_PER_POSE = 12
BYTES_PER_COVARIANCE = 12
"""Six half-precision numbers."""
BYTES_PER_SCALE = 8
"""Four half-precision numbers: what odometry alone told, its scale and how sure that is."""
BYTES_PER_REQUEST = 4
"""Robot and number of the keyframe whose scan is wanted."""
BYTES_PER_COUNT = 2
"""One entry of the list that says how many keyframes of each robot somebody holds."""

KEPT_MAX = 64
"""From so many keyframes of a robot on it is asked, whenever one more comes, which of them all mappers hold."""

KINDS = ("pose", "text", "fingerprint", "scan", "request", "inventory")


@dataclass(slots=True)
class Delivery:
    """What reaches one mapper in one step."""

    keyframes: list[Keyframe] = field(default_factory=list)
    scans: list[tuple[int, int]] = field(default_factory=list)
    """(robot, keyframe index) of scans that came on request."""


_NOTHING = [Delivery()]
"""To the one mapper, where nobody has anything new to tell; never written to."""


class Exchange:
    """Who holds which keyframes and scans; contacts in, deliveries out. Lost messages are repeated, and cost again."""

    def __init__(self, config: EnvConfig, robot_count: int):
        self._on_request = config.link.scan_on_request
        self._is_central = config.link.topology == "central"
        mappers = 1 if self._is_central else robot_count
        self._beam_count = config.lidar.beam_count
        self._paths: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        """Of each robot the keyframes that some mapper may still lack ..."""
        self._released = [0] * robot_count
        """... after so many that all mappers hold."""
        self._ends = [0] * robot_count
        """How many keyframes each robot has made."""
        self._made = 0
        """Keyframes of all robots ..."""
        self._heard = 0
        """... and those that mappers hold, summed over the mappers."""
        self._held = [[0] * robot_count for _ in range(mappers)]
        """How many keyframes of each robot a mapper holds."""
        self._scans: list[set[tuple[int, int]]] = [set() for _ in range(mappers)]
        """Scans of others that a mapper asked for and got."""
        self._told: list[list[list[int]]] = [[[] for _ in range(mappers)] for _ in range(mappers)]
        """What a peer was last told of another's holdings: by teller, told and robot."""
        self._pairs_of: Contacts | None = None
        self._pairs: list[tuple[int, int, bool]] = []
        """Listener, sender and whether it is heard, of every pair in touch, of these contacts."""
        self.bytes_sent = dict.fromkeys(KINDS, 0)
        """Kind of message -> bytes put on the air so far; what had to be sent twice counts twice."""

    def add(self, keyframe: Keyframe) -> None:
        """A robot made a keyframe."""
        path = self._paths[keyframe.robot]
        if len(path) >= KEPT_MAX:
            self._release(keyframe.robot)
        path.append(keyframe)
        self._ends[keyframe.robot] += 1
        self._made += 1

    def deliver(self, contacts: Contacts, wanted: Sequence[Collection[tuple[int, int]]]) -> list[Delivery]:
        """One step: what arrives at each mapper; `wanted` are the scans that each asks for.

        A keyframe travels one hop per step. Where several can tell a listener the same, the first one does.
        """
        if self._is_central and self._made == self._heard and not wanted[0]:
            return _NOTHING
        if contacts is not self._pairs_of:
            self._pairs_of = contacts
            self._pairs = [(i, k, bool(contacts.heard[i, k])) for i, k in np.argwhere(contacts.tried).tolist()]
        return [self._deliver_to_one(wanted[0])] if self._is_central else self._deliver_to_each(wanted)

    def _deliver_to_one(self, wanted: Collection[tuple[int, int]]) -> Delivery:
        """What arrives at the one mapper of all, straight from the robots."""
        delivery, held, ends = Delivery(), self._held[0], self._ends
        for _, sender, is_heard in self._pairs:
            if held[sender] < ends[sender]:
                self._tell_keyframes(delivery, 0, sender, ends[sender], is_heard)
            if wanted:
                self._tell_scans(delivery, 0, sender, wanted, is_heard)
        return delivery

    def _deliver_to_each(self, wanted: Sequence[Collection[tuple[int, int]]]) -> list[Delivery]:
        """What arrives at the mappers that robots carry."""
        deliveries = [Delivery() for _ in self._held]
        for robot, delivery in enumerate(deliveries):  # a robot needs no radio to hear itself
            if self._held[robot][robot] < self._ends[robot]:
                self._hand_over(delivery, robot, robot, self._lacked(robot, robot, self._ends[robot]))
        before = [held.copy() for held in self._held]
        for listener, sender, is_heard in self._pairs:
            self._tell_holdings(listener, sender, is_heard)
            for robot, count in enumerate(before[sender]):
                end = self._ends[robot] if robot == sender else count
                if self._held[listener][robot] < end:
                    self._tell_keyframes(deliveries[listener], listener, robot, end, is_heard)
            if wanted[listener]:
                self._tell_scans(deliveries[listener], listener, sender, wanted[listener], is_heard)
        return deliveries

    def _tell_holdings(self, listener: int, sender: int, is_heard: bool) -> None:
        """The listener says what it holds, when that changed since it last told this sender."""
        if self._told[listener][sender] == self._held[listener]:
            return
        self.bytes_sent["inventory"] += BYTES_PER_COUNT * len(self._paths)
        if is_heard:
            self._told[listener][sender] = self._held[listener].copy()

    def _tell_keyframes(self, delivery: Delivery, listener: int, robot: int, end: int, is_heard: bool) -> None:
        """Send what the listener lacks of a robot's keyframes before the one of number `end`."""
        lacked = self._lacked(listener, robot, end)
        for keyframe in lacked:
            self._count(keyframe)
        if is_heard:
            self._hand_over(delivery, listener, robot, lacked)

    def _hand_over(self, delivery: Delivery, listener: int, robot: int, lacked: list[Keyframe]) -> None:
        delivery.keyframes += lacked
        self._held[listener][robot] += len(lacked)
        self._heard += len(lacked)

    def _lacked(self, listener: int, robot: int, end: int) -> list[Keyframe]:
        """A robot's keyframes before the one of number `end` that the listener does not hold."""
        released = self._released[robot]
        return self._paths[robot][self._held[listener][robot] - released : end - released]

    def _release(self, robot: int) -> None:
        """Let go of what all mappers hold: nobody will ask for it again."""
        known = min(held[robot] for held in self._held)
        del self._paths[robot][: known - self._released[robot]]
        self._released[robot] = known

    def _tell_scans(self, delivery: Delivery, listener: int, sender: int, wanted, is_heard: bool) -> None:
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

    def _count(self, keyframe: Keyframe) -> None:
        sent = self.bytes_sent
        sent["pose"] += BYTES_PER_POSE + BYTES_PER_COVARIANCE
        if keyframe.odometry_scale != (0.0, 0.0):
            sent["pose"] += BYTES_PER_SCALE
        for sign in keyframe.signs:
            sent["text"] += len(sign.text.encode()) + BYTES_PER_POSE
        sent["fingerprint"] += BYTES_PER_FINGERPRINT_MAC * len(keyframe.fingerprint.macs)
        if not self._on_request:
            sent["scan"] += BYTES_PER_BEAM * len(keyframe.ranges_m)
