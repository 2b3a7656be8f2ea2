"""Where a training run's decisions come from: played in the learner's process, or by others.

Out: one ``Step`` a decision, episode after episode. ``InProcess`` acts with the newest weights
(``train.mode=exact``). ``Pipelined`` keeps a crew of workers busy with orders for whole episodes,
so that acting and learning go on at the same time (``train.mode=fast``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.api import Policy
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.rollout.episode import Row, decisions

Weights = Mapping[str, NDArray[Any]]
"""A network's ``state_dict`` as arrays."""
Judge = Callable[[Sequence[int]], list[Row]]
"""Plays an episode of each seed."""
Judged = Callable[[], list[Row] | None]
"""Waits for what a worker judged; None if it died."""


@dataclass(frozen=True)
class Step:
    """One decision; observations are what the network sees, (frames · (N + 3),)."""

    observation: NDArray[np.float32]
    action: int
    reward: float
    following: NDArray[np.float32]
    """The observation that followed."""
    ending: Row | None
    """None while the episode runs; else its ``seed``, ``outcome`` and metrics."""


@dataclass(frozen=True)
class Order:
    """What a worker needs to play one episode of training."""

    episode: int
    seed: int
    epsilon: float
    """Share of random actions."""
    decision: int
    """How far the learner was when it gave the order."""
    version: int
    """Updates that the weights had seen; orders of one version share them."""
    weights: Weights
    difficulty: float = 1.0
    """Of the terrain, 0 to 1."""


@dataclass(frozen=True)
class Played:
    """An episode that a worker played, T decisions long."""

    observations: NDArray[np.float32]
    """(T + 1, frames · (N + 3))"""
    actions: NDArray[np.int64]
    """(T,)"""
    rewards: NDArray[np.float64]
    """(T,)"""
    ending: Row

    def steps(self) -> Iterator[Step]:
        """The decisions in turn."""
        last = len(self.actions) - 1
        for t, (action, reward) in enumerate(zip(self.actions, self.rewards, strict=True)):
            now, following = self.observations[t], self.observations[t + 1]
            ending = self.ending if t == last else None
            yield Step(now, int(action), float(reward), following, ending)


class Collector(Protocol):
    """A source of episodes."""

    def episode(self) -> Iterator[Step]:
        """The decisions of one episode, to its end."""

    def judge(self, weights: Weights, seeds: Sequence[int], own: Judge) -> list[Row]:
        """Play an episode of each seed greedily, without exploration; ``own`` does so here."""

    def outstanding(self) -> list[Order]:
        """Orders that were given and are not yet played, oldest first."""

    def close(self) -> None:
        """Let go of processes."""


class Crew(Protocol):
    """Workers that play orders."""

    count: int
    """Workers."""
    capacity: int
    """Orders that keep all workers busy."""

    def send(self, order: Order) -> None:
        """Hand over an order; does not wait."""

    def take(self) -> tuple[Order, Played | None]:
        """Wait for an order and what became of it: None if its worker died."""

    def judge(self, weights: Weights, shares: Sequence[Sequence[int]]) -> list[Judged]:
        """Hand each worker its share of the seeds; does not wait. One share a worker."""

    def outstanding(self) -> list[Order]:
        """Orders handed over and not yet taken, oldest first."""

    def close(self) -> None:
        """Stop the workers."""


class InProcess:
    """Plays in this process: ``act`` sees every update that came before."""

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
        """Each decision is made when it is asked for."""
        seed, difficulty, frames = self._next_seed(), self._difficulty(), self._frames
        for d in decisions(self._env, self._policy, seed, difficulty=difficulty):
            ending = None if d.ending is None else {**d.ending, "difficulty": difficulty}
            now, following = (stacked(p.recent, frames) for p in (d.perception, d.next_perception))
            yield Step(now, d.action, d.reward, following, ending)

    def judge(self, weights: Weights, seeds: Sequence[int], own: Judge) -> list[Row]:
        """All are played here."""
        return own(seeds)

    def outstanding(self) -> list[Order]:
        """None."""
        return []

    def close(self) -> None:
        """Nothing to let go of."""


class Pipelined:
    """Gives orders ahead, and hands on what the crew played."""

    def __init__(
        self,
        crew: Crew,
        next_order: Callable[[], Order],
        lost: Callable[[Order], None],
        taken: Callable[[Order], bool],
    ) -> None:
        """``lost`` hears of each order whose worker died; ``taken`` says whether it is of use."""
        self._crew, self._next_order = crew, next_order
        self._lost, self._taken = lost, taken

    def resume(self, orders: list[Order]) -> None:
        """Give orders again that were outstanding when the run was saved."""
        for order in orders:
            self._crew.send(order)

    def episode(self) -> Iterator[Step]:
        """The next episode, as the crew hands it over."""
        while True:
            while len(self._crew.outstanding()) < self._crew.capacity:
                self._crew.send(self._next_order())
            order, played = self._crew.take()
            if played is None:
                self._lost(order)
            elif self._taken(order):
                break
        yield from played.steps()

    def judge(self, weights: Weights, seeds: Sequence[int], own: Judge) -> list[Row]:
        """Shared out evenly among the crew and this process."""
        shares = [seeds[start :: self._crew.count + 1] for start in range(self._crew.count + 1)]
        waiting = self._crew.judge(weights, shares[1:])
        rows = own(shares[0])
        for share, judged in zip(shares[1:], waiting, strict=True):
            found = judged()
            rows += own(share) if found is None else found
        place = {seed: index for index, seed in enumerate(seeds)}
        return sorted(rows, key=lambda row: place[row["seed"]])

    def outstanding(self) -> list[Order]:
        """What the crew has yet to hand over."""
        return self._crew.outstanding()

    def close(self) -> None:
        """Stop the crew."""
        self._crew.close()
