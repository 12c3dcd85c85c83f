"""The radio link from each robot to the team's mapper: what arrives in which step, and what it costs in bytes."""

from __future__ import annotations

from collections import deque

import numpy as np

from twc_env.config import LinkConfig

BYTES_PER_BEAM = 2
BYTES_PER_FINGERPRINT_MAC = 7
"""Six bytes of address and one of strength."""
BYTES_PER_POSE = 12


class Link:
    """Stores what robots send and forwards it; a lost message is sent again in the next step, in order per robot."""

    def __init__(self, config: LinkConfig, robots: int, random: np.random.Generator):
        self._loss_probability = config.loss_probability
        self._random = random
        self._queues: tuple[deque, ...] = tuple(deque() for _ in range(robots))
        self.bytes_sent: dict[str, int] = {}
        """Kind of message -> bytes put on the air so far; what had to be sent twice counts twice."""

    def send(self, robot: int, kind: str, payload: object, byte_count: int) -> None:
        """Queue one message of a robot."""
        self._queues[robot].append((kind, payload, byte_count))

    def deliver(self) -> list:
        """The payloads that arrive in this step, robot by robot in the order they were sent."""
        arrived = []
        for queue in self._queues:
            while queue:
                kind, payload, byte_count = queue[0]
                self.bytes_sent[kind] = self.bytes_sent.get(kind, 0) + byte_count
                if self._loss_probability > 0 and self._random.random() < self._loss_probability:
                    break
                arrived.append(payload)
                queue.popleft()
        return arrived
