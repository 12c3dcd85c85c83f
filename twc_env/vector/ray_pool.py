"""Workers of a Ray cluster that execute the environments of `VectorTeams` (extra `ray`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

from numpy.typing import NDArray as Array

from twc_env.errors import DataError, TwcError, WorkerError
from twc_env.running.finished_parts import code_digest
from twc_env.running.ray_cluster import RETRIES, connected
from twc_env.vector.environment_group import RESET, STEP, EnvironmentGroup, Infos
from twc_env.vector.episode_actions import EpisodeActions
from twc_env.vector.shared_arrays import SharedArrays


class _Order(NamedTuple):
    command: int
    k: int
    seed: int
    actions: Array | None


class RayPool:
    """Actors of a cluster, each with a share of the environments; k belongs to actor k modulo their number.

    Same interface as `EnvironmentGroup`, except that results come in the order in which they are ready. The
    environments of an actor that is lost with its process or machine begin anew in another one, and play what they had
    played (`EpisodeActions`), so that results do not show it.
    """

    def __init__(self, workers: int, shape: tuple, arrays: SharedArrays, episodes: EpisodeActions, address: str):
        """workers: actors; 0: one per core of the cluster. shape: arguments of `SharedArrays`.

        Raises DataError as `connected` does.
        """
        self._arrays, self._episodes, self._shape = arrays, episodes, shape
        self._connection = ExitStack()
        self._ray = self._connection.enter_context(connected(address))
        cores = int(self._ray.cluster_resources().get("CPU", 1))
        self.workers = min(shape[0], workers or cores)
        self._actors: list[Any] = []
        self._waiting: dict[Any, tuple[int, _Order]] = {}
        """Reference of a result -> actor and order."""
        self._losses = 0

    def start(self, config: dict, buildings: tuple[str, ...]) -> None:
        """Start the actors. Raises DataError, and closes the connection, if one does not start or if its machine has
        other code."""
        self._task = self._shape, config, buildings
        with ExitStack() as unless_started:
            unless_started.callback(self.close)
            free = int(self._ray.available_resources().get("CPU", 0))
            self._actors = [self._new_actor(number, float(free >= self.workers)) for number in range(self.workers)]
            try:
                digests = self._ray.get([actor.code.remote() for actor in self._actors])
            except self._ray.exceptions.RayError as error:
                raise DataError(
                    f"a worker of the Ray cluster does not start ({type(error).__name__}): twc_env must be installed "
                    "on all its machines, and their memory must suffice"
                ) from error
            if other := set(digests) - {code_digest()}:
                raise DataError(
                    f"a machine of the Ray cluster has other code ({other.pop()}) than this one ({code_digest()}): "
                    "install the same version of twc_env everywhere"
                )
            unless_started.pop_all()

    def _new_actor(self, number: int, cores: float) -> Any:
        """cores: reserved for it. Without any it also starts on a cluster that has none left, such as one that has just
        lost a machine."""
        ids = range(number, self._shape[0], self.workers)
        remote = self._ray.remote(num_cpus=cores, scheduling_strategy="DEFAULT" if cores else "SPREAD")(RemoteGroup)
        return remote.remote(ids, *self._task)

    def submit(self, command: int, ids: Sequence[int], seeds: Sequence[int] = ()) -> None:
        """Start a command in each of these environments, none of which may have a result that was not yet taken.
        RESET needs one seed per environment."""
        for k, seed in zip(ids, seeds or [0] * len(ids), strict=True):
            actions = self._arrays.actions[k].copy() if command == STEP else None
            self._send(k % self.workers, _Order(command, k, seed, actions))

    def _send(self, number: int, order: _Order) -> None:
        self._waiting[self._actors[number].execute.remote(*order)] = number, order

    def results(self, count: int) -> Iterator[tuple[int, Infos | TwcError]]:
        """The next `count` results as they become ready. Raises WorkerError if workers were lost repeatedly, and any
        other error of an environment than a TwcError as it was raised there."""
        for _ in range(count):
            yield self._next()

    def _next(self) -> tuple[int, Infos | TwcError]:
        ray = self._ray
        while True:
            (done,), _ = ray.wait(list(self._waiting), num_returns=1)
            try:
                result, rows = ray.get(done)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
            except ray.exceptions.RayError as error:
                self._replace(self._waiting[done][0], error)
                continue
            _, order = self._waiting.pop(done)
            arrays, k = self._arrays, order.k
            blocks, arrays.rewards[k], arrays.states[k], arrays.ended[k] = rows
            for name, block in blocks.items():
                arrays.observations[name][k] = block
            return k, result

    def _replace(self, number: int, error: Exception) -> None:
        """Another actor takes the place of one that was lost, and executes what it had not answered."""
        self._losses += 1
        if self._losses > RETRIES * self.workers:
            raise WorkerError(
                f"workers of the Ray cluster were lost {self._losses} times ({type(error).__name__}): see the "
                "machines' memory"
            ) from error
        self._ray.kill(self._actors[number])  # it may only be out of reach
        self._actors[number] = actor = self._new_actor(number, 0.0)
        lost = {order.k: order for own, order in self._waiting.values() if own == number}
        self._waiting = {key: (own, order) for key, (own, order) in self._waiting.items() if own != number}
        for k in range(number, self._shape[0], self.workers):
            order, seed, actions = lost.get(k), self._episodes.seeds[k], self._episodes.of(k)
            if seed is not None and (order is None or order.command != RESET):
                actor.play_again.remote(k, seed, actions[:-1] if order and order.command == STEP else actions)
            if order is not None:
                self._send(number, order)

    def close(self) -> None:
        """End the actors. Again: nothing happens."""
        actors, self._actors = self._actors, []
        for actor in actors:
            self._ray.kill(actor)
        self._connection.close()


class RemoteGroup:
    """An `EnvironmentGroup` in an actor, with arrays of its own."""

    def __init__(self, ids: Sequence[int], shape: tuple, config: dict, buildings: tuple[str, ...]):
        self._arrays = SharedArrays(*shape)
        self._group = EnvironmentGroup(ids, self._arrays, config, buildings)

    def code(self) -> str:
        """Digest of the code here."""
        return code_digest()

    def execute(self, command: int, k: int, seed: int, actions: Array | None) -> tuple[Infos | TwcError, tuple]:
        """Execute one command: its result, and the rows of environment k."""
        arrays = self._arrays
        if actions is not None:
            arrays.actions[k] = actions
        result: Infos | TwcError
        try:
            result = self._group.execute(command, k, seed)
        except TwcError as error:
            result = error
        blocks = {name: block[k] for name, block in arrays.observations.items()}
        return result, (blocks, arrays.rewards[k], arrays.states[k], bool(arrays.ended[k]))

    def play_again(self, k: int, seed: int, actions: Array) -> None:
        """Begin the episode of a seed in environment k, and play these actions (steps, robots, ...)."""
        self.execute(RESET, k, seed, None)
        for each in actions:
            self.execute(STEP, k, 0, each)
