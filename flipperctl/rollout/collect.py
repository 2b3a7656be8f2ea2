"""Collectors of training episodes: in the learner's own process, or from workers.

Out: one ``Step`` for each decision, episode after episode. ``InProcessCollector`` acts with the
newest weights (``train.mode=exact``). ``AsyncCollector`` keeps workers busy with requests for whole
episodes, so that acting and learning go on at the same time (``train.mode=fast``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from flipperctl.agent.frames import stacked
from flipperctl.api import Policy
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.taught import TaughtPolicy
from flipperctl.rollout.episode import Row, decisions
from flipperctl.rollout.values import (
    EvaluateHere,
    PendingEvaluation,
    Rollout,
    RolloutRequest,
    Step,
    Weights,
)


class Collector(Protocol):
    """A source of episodes."""

    def episode(self) -> Iterator[Step]:
        """Yield the steps of one episode, to its end."""

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], evaluate_here: EvaluateHere
    ) -> list[Row]:
        """Play one greedy episode for each seed; ``evaluate_here`` does so in this process."""

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests whose episodes have not been collected yet, oldest first."""

    def close(self) -> None:
        """Release worker processes."""


class RolloutWorkers(Protocol):
    """Workers that play the episodes that they are requested to play."""

    count: int
    """Number of workers."""
    capacity: int
    """Number of requests that keeps all workers busy."""

    def send(self, request: RolloutRequest) -> None:
        """Send a request; does not wait."""

    def take(self) -> tuple[RolloutRequest, Rollout | None]:
        """Wait for a request and return it with its rollout, or with None if its worker died."""

    def evaluate(self, weights: Weights, parts: Sequence[Sequence[int]]) -> list[PendingEvaluation]:
        """Send each worker one part of the seeds; does not wait."""

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent and not yet taken, oldest first."""

    def close(self) -> None:
        """Stop the workers."""


class InProcessCollector:
    """Plays in this process, so that the policy acts with the newest weights."""

    def __init__(
        self,
        env: FlipperEnv,
        policy: Policy,
        next_seed: Callable[[], int],
        difficulty: Callable[[], float] = lambda: 1.0,
        frames: int = 1,
    ) -> None:
        """``next_seed`` and ``difficulty`` are called before each episode.

        ``frames``: number of observations that the network takes as one input.
        """
        self._env, self._policy, self._frames = env, policy, frames
        self._next_seed, self._difficulty = next_seed, difficulty

    def episode(self) -> Iterator[Step]:
        """Yield the steps of one episode; each is made when the iterator asks for it."""
        seed, difficulty, frames = self._next_seed(), self._difficulty(), self._frames
        for d in decisions(self._env, self._policy, seed, difficulty=difficulty):
            ending = None if d.ending is None else {**d.ending, "difficulty": difficulty}
            observation = stacked(d.perception.recent, frames)
            next_observation = stacked(d.next_perception.recent, frames)
            label = self._policy.label if isinstance(self._policy, TaughtPolicy) else None
            yield Step(observation, d.action, d.reward, next_observation, ending, label)

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], evaluate_here: EvaluateHere
    ) -> list[Row]:
        """Play all episodes in this process."""
        return evaluate_here(seeds)

    def outstanding(self) -> list[RolloutRequest]:
        """Return an empty list: nothing is requested ahead of its use."""
        return []

    def close(self) -> None:
        """Nothing to release."""


class AsyncCollector:
    """Requests episodes ahead of their use, and yields the steps that the workers played."""

    def __init__(
        self,
        workers: RolloutWorkers,
        next_request: Callable[[], RolloutRequest],
        on_lost: Callable[[RolloutRequest], None],
        accept: Callable[[RolloutRequest], bool],
    ) -> None:
        """``next_request`` makes the request of the next episode.

        ``on_lost`` is called with each request whose worker died; ``accept`` returns whether the
        rollout of a request is still used, or dropped.
        """
        self._workers, self._next_request = workers, next_request
        self._on_lost, self._accept = on_lost, accept

    def resume(self, requests: Sequence[RolloutRequest]) -> None:
        """Send the requests again that were outstanding when the run was saved."""
        for request in requests:
            self._workers.send(request)

    def episode(self) -> Iterator[Step]:
        """Yield the steps of the next episode that the workers return."""
        workers = self._workers
        while True:
            while len(workers.outstanding()) < workers.capacity:
                workers.send(self._next_request())
            request, rollout = workers.take()
            if rollout is None:
                self._on_lost(request)
            elif self._accept(request):
                break
        yield from rollout.steps()

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], evaluate_here: EvaluateHere
    ) -> list[Row]:
        """Divide the episodes evenly among the workers and this process."""
        count = self._workers.count + 1
        parts = [seeds[start::count] for start in range(count)]
        pending = self._workers.evaluate(weights, parts[1:])
        rows = evaluate_here(parts[0])
        for part, wait in zip(parts[1:], pending, strict=True):
            received = wait()
            rows += evaluate_here(part) if received is None else received
        place = {seed: index for index, seed in enumerate(seeds)}
        return sorted(rows, key=lambda row: place[row["seed"]])

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that the workers have not played yet, oldest first."""
        return self._workers.outstanding()

    def close(self) -> None:
        """Stop the workers."""
        self._workers.close()
