"""Collectors of training episodes: in the learner's own process, or from workers.

Out: one ``Step`` for each decision, episode after episode. ``InProcessCollector`` acts with the
newest weights (``train.mode=exact``). ``AsyncCollector`` keeps workers busy with requests for whole
episodes, so that acting and learning run in parallel (``train.mode=fast``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from typing import Protocol

from flipperctl.agent.frames import stacked
from flipperctl.api import Policy
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.privileged import PrivilegedStates
from flipperctl.policies.abilities import LabellingPolicy, TrainingPolicy
from flipperctl.rollout.episode import Row, decisions
from flipperctl.rollout.pool import WorkerDiedError
from flipperctl.rollout.values import (
    POLL,
    PlayHere,
    Rollout,
    RolloutRequest,
    Step,
    Stop,
    Weights,
)


class Collector(Protocol):
    """A source of episodes."""

    def episode(self) -> Iterator[Step]:
        """Yield the steps of one whole episode; none if the run is to stop first."""

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], play_here: PlayHere
    ) -> list[Row] | None:
        """Play one greedy episode for each seed; ``play_here`` plays one in this process.

        Returns the rows in the order of the seeds; None if the run is to stop before the last.
        """

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests whose episodes have not been collected yet, oldest first."""

    def close(self) -> None:
        """Release worker processes."""


class RolloutWorkers(Protocol):
    """Workers that play requested episodes."""

    @property
    def capacity(self) -> int:
        """Number of requests that keeps all workers busy."""

    def send(self, request: RolloutRequest) -> None:
        """Send a request without waiting."""

    def take(self, stop: Stop) -> tuple[RolloutRequest, Rollout | None] | None:
        """Wait for a rollout; return its request with it, or with None if the worker died.

        Returns None alone, and keeps the request, if the run is to stop before a rollout arrives.
        """

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Future[Row]]:
        """Request one greedy episode for each seed from the free workers, without waiting.

        The future of an episode that no worker has begun can be cancelled. If its worker died, it
        raises ``WorkerDiedError``.
        """

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent but not yet taken, oldest first."""

    def close(self) -> None:
        """Stop the workers."""


class InProcessCollector:
    """Plays in this process; the policy acts with the newest weights."""

    def __init__(
        self,
        env: FlipperEnv,
        policy: Policy,
        next_seed: Callable[[], int],
        difficulty: Callable[[], float] = lambda: 1.0,
        frames: int = 1,
        stop: Stop = lambda: False,
        *,
        privileged: bool = False,
    ) -> None:
        """``next_seed`` and ``difficulty`` are called before each episode.

        ``frames``: number of observations that the network takes as one input. ``stop`` can end an
        evaluation between two episodes. ``privileged``: whether the steps have privileged states.
        """
        self._privileged = privileged
        self._env, self._policy, self._frames, self._stop = env, policy, frames, stop
        self._labelling = policy if isinstance(policy, LabellingPolicy) else None
        self._exploring = policy if isinstance(policy, TrainingPolicy) else None
        self._next_seed, self._difficulty = next_seed, difficulty

    def episode(self) -> Iterator[Step]:
        """Yield the steps of one episode; each is made on request of the iterator."""
        seed, difficulty, frames = self._next_seed(), self._difficulty(), self._frames
        states = PrivilegedStates(self._env) if self._privileged else None
        for d in decisions(self._env, self._policy, seed, difficulty=difficulty):
            ending = None if d.ending is None else {**d.ending, "difficulty": difficulty}
            observation = stacked(d.perception.recent, frames)
            next_observation = stacked(d.next_perception.recent, frames)
            label = None if self._labelling is None else self._labelling.label
            valued = self._labelling if ending is not None else None
            if states is not None:
                states.add(d.transition)
            yield Step(
                observation=observation,
                action=d.action,
                reward=d.reward,
                next_observation=next_observation,
                ending=ending,
                label=label,
                groups=None if valued is None else valued.groups,
                explored=self._exploring is not None and self._exploring.explored,
                privileged=None if states is None else states.rows[-2],
                next_privileged=None if states is None else states.rows[-1],
            )

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], play_here: PlayHere
    ) -> list[Row] | None:
        """Play all episodes in this process; return None if the run is to stop before the last."""
        rows = []
        for seed in seeds:
            if self._stop():
                return None
            rows.append(play_here(seed))
        return rows

    def outstanding(self) -> list[RolloutRequest]:
        """Return an empty list: no episode is requested ahead of its use."""
        return []

    def close(self) -> None:
        """Do nothing: there are no worker processes."""


class AsyncCollector:
    """Requests episodes ahead of their use, and yields the steps that the workers played."""

    def __init__(
        self,
        workers: RolloutWorkers,
        next_request: Callable[[], RolloutRequest],
        on_lost: Callable[[RolloutRequest], None],
        accept: Callable[[RolloutRequest], bool],
        stop: Stop = lambda: False,
    ) -> None:
        """``next_request`` makes the request of the next episode.

        ``on_lost`` is called with each request whose worker died; ``accept`` returns whether the
        rollout of a request is still used. ``stop`` ends any wait for workers.
        """
        self._workers, self._next_request = workers, next_request
        self._on_lost, self._accept, self._stop = on_lost, accept, stop

    def resume(self, requests: Sequence[RolloutRequest]) -> None:
        """Resend the requests that were outstanding when the run was saved."""
        for request in requests:
            self._workers.send(request)

    def episode(self) -> Iterator[Step]:
        """Yield the steps of the next episode that the workers return; none if the run stops."""
        workers = self._workers
        while True:
            while len(workers.outstanding()) < workers.capacity:
                workers.send(self._next_request())
            taken = workers.take(self._stop)
            if taken is None:
                return
            request, rollout = taken
            if rollout is None:
                self._on_lost(request)
            elif self._accept(request):
                break
        yield from rollout.steps()

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], play_here: PlayHere
    ) -> list[Row] | None:
        """Play one episode for each seed: workers from the first on, this process from the last.

        Returns the rows in the order of the seeds; None if the run is to stop before the last.
        """
        futures = self._workers.evaluate(weights, seeds)
        rows: list[Row] = []
        for future, seed in zip(reversed(futures), reversed(seeds), strict=True):
            row = self._row(future, seed, play_here)
            if row is None:
                for other in futures:
                    other.cancel()
                return None
            rows.insert(0, row)
        return rows

    def _row(self, future: Future[Row], seed: int, play_here: PlayHere) -> Row | None:
        """Return the row of an episode, played here if no worker has begun it; None to stop."""
        if self._stop():
            return None
        if future.cancel():
            return play_here(seed)
        while not wait([future], POLL).done:
            if self._stop():
                return None
        try:
            return future.result()
        except WorkerDiedError:
            return play_here(seed)

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that the workers have not played yet, oldest first."""
        return self._workers.outstanding()

    def close(self) -> None:
        """Stop the workers."""
        self._workers.close()
