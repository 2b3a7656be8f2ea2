"""Where a learner's decisions come from: its own process, or workers.

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
        """Yield the decisions of one episode, to its end."""

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], evaluate_here: EvaluateHere
    ) -> list[Row]:
        """Play an episode of each seed greedily; ``evaluate_here`` does so in this process."""

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that are not yet played, oldest first."""

    def close(self) -> None:
        """Release worker processes."""


class RolloutWorkers(Protocol):
    """Workers that play what they are requested to."""

    count: int
    """Workers."""
    capacity: int
    """Requests that keep all workers busy."""

    def send(self, request: RolloutRequest) -> None:
        """Send a request; does not wait."""

    def take(self) -> tuple[RolloutRequest, Rollout | None]:
        """Wait for a request and its rollout: None if its worker died."""

    def evaluate(self, weights: Weights, parts: Sequence[Sequence[int]]) -> list[PendingEvaluation]:
        """Send each worker one part of the seeds; does not wait."""

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent and not yet taken, oldest first."""

    def close(self) -> None:
        """Stop the workers."""


class InProcessCollector:
    """Plays in this process: the policy acts after every update that came before."""

    def __init__(
        self,
        env: FlipperEnv,
        policy: Policy,
        next_seed: Callable[[], int],
        difficulty: Callable[[], float] = lambda: 1.0,
        frames: int = 1,
    ) -> None:
        """``frames``: observations that the network takes in at once."""
        self._env, self._policy, self._frames = env, policy, frames
        self._next_seed, self._difficulty = next_seed, difficulty

    def episode(self) -> Iterator[Step]:
        """Yield the decisions of one episode; each is made when it is asked for."""
        seed, difficulty, frames = self._next_seed(), self._difficulty(), self._frames
        for d in decisions(self._env, self._policy, seed, difficulty=difficulty):
            ending = None if d.ending is None else {**d.ending, "difficulty": difficulty}
            now, following = (stacked(p.recent, frames) for p in (d.perception, d.next_perception))
            yield Step(now, d.action, d.reward, following, ending)

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], evaluate_here: EvaluateHere
    ) -> list[Row]:
        """Play all episodes here."""
        return evaluate_here(seeds)

    def outstanding(self) -> list[RolloutRequest]:
        """Return no request: an episode is played when it is asked for."""
        return []

    def close(self) -> None:
        """Nothing to release."""


class AsyncCollector:
    """Requests episodes ahead of their use, and yields what the workers played."""

    def __init__(
        self,
        workers: RolloutWorkers,
        next_request: Callable[[], RolloutRequest],
        on_lost: Callable[[RolloutRequest], None],
        accept: Callable[[RolloutRequest], bool],
    ) -> None:
        """``on_lost`` is called with each request whose worker died.

        ``accept`` decides whether a rollout is still of use.
        """
        self._workers, self._next_request = workers, next_request
        self._on_lost, self._accept = on_lost, accept

    def resume(self, requests: Sequence[RolloutRequest]) -> None:
        """Make requests again that were outstanding when the run was saved."""
        for request in requests:
            self._workers.send(request)

    def episode(self) -> Iterator[Step]:
        """Yield the decisions of the next episode that the workers return."""
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
            found = wait()
            rows += evaluate_here(part) if found is None else found
        place = {seed: index for index, seed in enumerate(seeds)}
        return sorted(rows, key=lambda row: place[row["seed"]])

    def outstanding(self) -> list[RolloutRequest]:
        """Return what the workers have yet to play."""
        return self._workers.outstanding()

    def close(self) -> None:
        """Stop the workers."""
        self._workers.close()
