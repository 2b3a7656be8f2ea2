"""Play the episodes of an evaluation in order, in one process or several.

In: an environment configuration and a policy's source. Out: one result per episode,
independent of the number of processes.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from flipperctl import plugins
from flipperctl.api import Profile, RobotState, Transition
from flipperctl.config import EnvConfig, container, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.policies.demonstrating import DemonstratingPolicy
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, decisions, play
from flipperctl.rollout.pool import PendingCall, WorkerDiedError, WorkerPool
from flipperctl.rollout.recording import EpisodeRecorder
from flipperctl.rollout.seeds import episode_seed

_log = logging.getLogger(__name__)


class EpisodeRunner:
    """An environment and a policy, ready to play any episode of an evaluation."""

    def __init__(
        self,
        config: EnvConfig,
        source: PolicySource,
        seed: int,
        report_progress: Callable[[float], None] = lambda fraction: None,
        *,
        record: bool = False,
    ) -> None:
        """Build the environment and the policy.

        ``seed`` is the seed of the evaluation. ``report_progress`` is called with the finished
        fraction of an episode's search. ``record``: whether results hold their decisions.

        Raises:
            FlipperctlError: the policy cannot be built (see ``PolicySource.build``).
        """
        self._env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._policy = source.build(config.perception)
        self._seed = seed
        self._record = record

    def play(self, index: int) -> EpisodeResult:
        """Play one episode, counted from 0, to its end."""
        seed = episode_seed("evaluation", self._seed, index)
        if self._record:
            return self._recorded(index, seed)
        row = play(self._env, self._policy, seed, report_progress=self._report_progress)
        return EpisodeResult.of(index, row)

    def _recorded(self, index: int, seed: int) -> EpisodeResult:
        policy, recorder = DemonstratingPolicy(self._policy), EpisodeRecorder()

        def watch(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            recorder.add(before, d.action, d.reward, after, policy.label)

        row = play(self._env, policy, seed, watch=watch, report_progress=self._report_progress)
        return replace(EpisodeResult.of(index, row), recorded=recorder.finish(index, row))

    def trace(self, index: int) -> tuple[list[RobotState], Profile]:
        """Play one episode; return the states at all T + 1 decisions, and the ground."""
        transitions, profile = self.transitions(index)
        return [transitions[0].before, *(t.after for t in transitions)], profile

    def transitions(self, index: int) -> tuple[list[Transition], Profile]:
        """Play one episode; return its T transitions, and the ground."""
        seed = episode_seed("evaluation", self._seed, index)
        made = decisions(self._env, self._policy, seed, report_progress=self._report_progress)
        return [d.transition for d in made], self._env.profile


def play_episodes(
    config: EnvConfig,
    source: PolicySource,
    *,
    episodes: int | Sequence[int],
    seed: int,
    jobs: int = 1,
    report_progress: Callable[[float], None] = lambda fraction: None,
    record: bool = False,
) -> Iterator[EpisodeResult]:
    """Yield the results of the episodes, in order, each as soon as it is known.

    ``episodes`` is their number, counted from 0, or their indices. ``jobs`` is the number of
    processes; a worker that dies is replaced. ``report_progress`` is called with the finished
    fraction of an episode's search if one process plays all episodes. ``record``: whether the
    results hold their decisions.

    Raises:
        FlipperctlError: the policy cannot be built or failed, or an episode killed its workers.
    """
    indices = range(episodes) if isinstance(episodes, int) else episodes
    if jobs == 1 or not indices:
        runner = EpisodeRunner(config, source, seed, report_progress, record=record)
        yield from map(runner.play, indices)
        return
    document = container(config.environment())
    arguments = (document, source, seed, plugins.configured_paths(), record)
    workers = WorkerPool(min(jobs, len(indices)), _start_worker, arguments)
    try:
        waiting = deque(workers.submit(_play_in_worker, index) for index in indices)
        for index in indices:
            yield _result(workers, waiting.popleft(), index)
    finally:
        workers.close()


def _result(workers: WorkerPool, job: PendingCall, index: int) -> EpisodeResult:
    """Wait for an episode; play it again if its worker died, since equal seeds repeat it."""
    for _ in range(workers.count + 2):  # all may have died at once
        try:
            result: EpisodeResult = workers.result(job)
            return result
        except WorkerDiedError:
            _log.warning("a worker died and is replaced; episode %d is played again", index)
            job = workers.submit(_play_in_worker, index)
    raise FlipperctlError(f"episode {index} of the evaluation killed its worker again and again")


_runner: EpisodeRunner | FlipperctlError | None = None  # one per worker process


def _start_worker(
    config: dict[str, Any],
    source: PolicySource,
    seed: int,
    plugin_paths: list[str],
    record: bool,
) -> None:
    global _runner
    import torch

    torch.set_num_threads(1)
    try:
        plugins.load(plugin_paths)
        _runner = EpisodeRunner(parse(EnvConfig, config), source, seed, record=record)
    except FlipperctlError as error:  # an initialiser's error would only break the pool
        _runner = error


def _play_in_worker(index: int) -> EpisodeResult:
    if not isinstance(_runner, EpisodeRunner):
        raise _runner or RuntimeError("the worker was not started")
    return _runner.play(index)
