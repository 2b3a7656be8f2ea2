"""Play what a store lacks of the planned episodes, here or on a Ray cluster.

In: configurations and policies' sources. Out: rows of episodes, of which each is played once,
however many scenes, policies and views ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, closing, contextmanager

from flipperctl.config import EvalConfig
from flipperctl.errors import FlipperctlError, InterruptedRunError, OutputError, WriteError
from flipperctl.evaluation.rows import Episodes, Row
from flipperctl.evaluation.store import EpisodeStore, StoreKey, blocks
from flipperctl.evaluation.workers import (
    EpisodeWorkers,
    Task,
    play_block,
    require_unchanged,
    worker_pool,
)
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.rollout import cluster
from flipperctl.rollout.pool import POLL

Progress = Callable[[str, int], AbstractContextManager[Callable[[float], None]]]
"""Opens a progress display from a label and a number of episodes. Its context manager yields a
function of the number of finished episodes, in which a search counts as a fraction of its episode.
"""
NOT_A_POLICYS = (InterruptedRunError, OutputError, WriteError)
"""Errors that end an evaluation; any other one ends only the episodes of its policy on its scene.
"""


@contextmanager
def no_progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
    """Show nothing."""
    yield lambda done: None


class Player:
    """Takes episodes from a store, and lets workers play those that it lacks."""

    def __init__(
        self, store: EpisodeStore, workers: EpisodeWorkers, progress: Progress = no_progress
    ) -> None:
        self.store, self.workers, self.progress = store, workers, progress
        self._identities: list[tuple[PolicySource, PolicyIdentity]] = []

    def key(self, config: EvalConfig, source: PolicySource) -> StoreKey:
        """Return the key of a policy's episodes under a configuration."""
        known = next((found for who, found in self._identities if who == source), None)
        if known is None:
            known = PolicyIdentity.of(source)
            self._identities.append((source, known))
        return StoreKey.of(config, known)

    def missing(self, config: EvalConfig, source: PolicySource) -> list[list[int]]:
        """Return the blocks of the evaluation that the store lacks, as indices of episodes."""
        held = self.store.find(self.key(config, source))
        lacking = [i for i in range(config.eval.episodes) if i not in held]
        return list(blocks(lacking, config.eval.cell))

    def known(self, config: EvalConfig, source: PolicySource) -> Episodes | None:
        """Return all episodes of the evaluation if the store has them, else None."""
        held = self.store.find(self.key(config, source))
        wanted = range(config.eval.episodes)
        return Episodes(tuple(held[i] for i in wanted)) if all(i in held for i in wanted) else None

    def play(
        self,
        config: EvalConfig,
        source: PolicySource,
        label: str,
        indices: Sequence[int] | None = None,
        *,
        record: bool = False,
    ) -> Episodes:
        """Return the episodes at ``indices``, or all of the evaluation; fewer after a stop.

        The progress is shown under the ``label``. ``record``: play all, since stored rows have no
        decisions.

        Raises:
            OutputError, WriteError: a block cannot be written.
            FlipperctlError: the policy cannot be built or failed. The blocks before the failure are
                stored, and the failure is noted.
        """
        key = self.key(config, source)
        chosen = list(range(config.eval.episodes)) if indices is None else list(indices)
        held = {} if record else self.store.find(key)
        missing = [index for index in chosen if index not in held]
        if missing:
            self.workers.use(config.eval.jobs)
            with self.progress(label, len(missing)) as report:
                done = 0

                def search(fraction: float) -> None:
                    report(done + fraction)

                rows = self.workers.play(
                    config, source, missing, report_progress=search, record=record
                )
                for row in self._kept(key, source, missing, rows):
                    held[row["episode"]] = row
                    done += 1
                    report(done)
        return Episodes(tuple(held[index] for index in chosen if index in held))

    def play_many(
        self, requests: Sequence[tuple[EvalConfig, PolicySource]], label: str
    ) -> Iterator[Episodes]:
        """Yield the episodes of each request, in order; fewer requests after a stop.

        The episodes of all requests share the worker processes at once. The progress counts
        requests. See ``play``.
        """
        wanted = [range(config.eval.episodes) for config, _ in requests]
        found = [self.store.find(self.key(*request)) for request in requests]
        missing = [
            [index for index in indices if index not in held]
            for indices, held in zip(wanted, found, strict=True)
        ]
        lacking = [
            (*request, indices)
            for request, indices in zip(requests, missing, strict=True)
            if indices
        ]
        if lacking:
            self.workers.use(lacking[0][0].eval.jobs)
        played = self.workers.play_many(lacking)
        with self.progress(label, len(requests)) as report:
            for at, (request, held) in enumerate(zip(requests, found, strict=True)):
                if missing[at]:
                    rows = self._kept(self.key(*request), request[1], missing[at], next(played))
                    held |= {row["episode"]: row for row in rows}
                if any(index not in held for index in wanted[at]):
                    return
                yield Episodes(tuple(held[index] for index in wanted[at]))
                report(at + 1)

    def _kept(
        self, key: StoreKey, source: PolicySource, missing: Sequence[int], rows: Iterator[Row]
    ) -> Iterator[Row]:
        """Yield the rows, and store them block by block; the last block even if it is cut off."""
        stored = self.store.find(key)
        size = key.config.eval.cell
        ends = [block[-1] for block in blocks([i for i in missing if i not in stored], size)]
        waiting: list[Row] = []
        count = 0

        def keep() -> None:
            part = [row for row in waiting if row["episode"] not in stored]
            waiting.clear()
            if part:
                require_unchanged(source, key.policy.digest)
                self.store.add(key, part)

        require_unchanged(source, key.policy.digest)
        try:
            for row in rows:
                waiting.append(row)
                count += 1
                if row["episode"] in ends:
                    keep()
                yield row
        except NOT_A_POLICYS:
            raise
        except FlipperctlError as error:
            first = missing[count]
            last = next((end for end in ends if end >= first), first)
            self.store.fail(key, first, last, error)
            raise
        finally:
            keep()

    def play_over_ray(
        self, requests: Sequence[tuple[EvalConfig, PolicySource]], address: str
    ) -> None:
        """Let a Ray cluster play every block that the store lacks, in any order.

        What the cluster could not play, the evaluation then plays itself.
        """
        wanted = list(self._blocks(requests))
        if not wanted:
            return
        with cluster.connected(address, "eval.ray", requests[0][0].eval.jobs):
            count = min(len(wanted), max(1, cluster.cpus()[1]))
            with closing(worker_pool(count, cluster.Hosts(count).start)) as pool:
                running = {
                    pool.submit(play_block, task, block, key.policy.digest): (key, len(block))
                    for key, task, block in wanted
                }
                total = sum(size for _, size in running.values())
                with self.progress("blocks over Ray", total) as report:
                    self._collect(running, report)

    def _blocks(
        self, requests: Sequence[tuple[EvalConfig, PolicySource]]
    ) -> Iterator[tuple[StoreKey, Task, list[int]]]:
        """Yield the blocks that the store lacks, each once."""
        seen: set[tuple[str, int]] = set()
        for config, source in requests:
            try:
                key, missing = self.key(config, source), self.missing(config, source)
            except FlipperctlError:  # the evaluation names it
                continue
            task = Task.of(config, source)
            for block in missing:
                if (key.text, block[0]) not in seen:
                    seen.add((key.text, block[0]))
                    yield key, task, block

    def _collect(
        self,
        running: dict[Future[list[Row]], tuple[StoreKey, int]],
        report: Callable[[float], None],
    ) -> None:
        """Store each block as it comes, until none is left or a stop is asked for."""
        played = 0
        while running and not self.workers.stop():
            for future in wait(running, POLL, FIRST_COMPLETED).done:
                key, size = running.pop(future)
                if future.exception() is None:  # else the evaluation plays it, and names its error
                    self.store.add(key, future.result())
                    played += size
                    report(played)
