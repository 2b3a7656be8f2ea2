"""Evaluation: a controller on a scene, episode after episode, in one process or several.

In: an environment configuration and a controller's source. Out: one row an episode, the same
whatever the number of processes.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from flipperctl import plugins
from flipperctl.api import Profile, RobotState
from flipperctl.config import EnvConfig, container, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.policies.trained import ControllerSource
from flipperctl.rollout.episode import decisions, play
from flipperctl.rollout.pool import PendingCall, WorkerDiedError, WorkerPool
from flipperctl.rollout.seeds import episode_seed

_log = logging.getLogger(__name__)


class Player:
    """An environment and a controller, ready to play any episode of an evaluation."""

    def __init__(
        self,
        config: EnvConfig,
        source: ControllerSource,
        seed: int,
        report_progress: Callable[[float], None] = lambda fraction: None,
    ) -> None:
        """``report_progress`` is called with the fraction of an episode's search that is done."""
        self._env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._controller = source.make(config.perception)
        self._seed = seed

    def episode(self, index: int) -> dict[str, Any]:
        """The row of one episode."""
        seed = episode_seed("evaluation", self._seed, index)
        return {
            "episode": index,
            **play(self._env, self._controller, seed, report_progress=self._report_progress),
        }

    def trace(self, index: int) -> tuple[list[RobotState], Profile]:
        """The states at every decision of one episode, and the ground it went over."""
        seed = episode_seed("evaluation", self._seed, index)
        seen = [d.transition for d in decisions(self._env, self._controller, seed)]
        return [seen[0].before, *(t.after for t in seen)], self._env.profile


def evaluate(
    config: EnvConfig,
    source: ControllerSource,
    *,
    episodes: int | Sequence[int],
    seed: int,
    jobs: int = 1,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the episodes, in order, as they are done.

    ``episodes``: how many, from 0, or which. ``report_progress`` is called with the fraction of an
    episode's search that is done, where one process plays them all.
    """
    indices = range(episodes) if isinstance(episodes, int) else episodes
    if jobs == 1 or not indices:
        player = Player(config, source, seed, report_progress)
        yield from map(player.episode, indices)
        return
    arguments = (container(config.environment()), source, seed, plugins.given())
    workers = WorkerPool(min(jobs, len(indices)), _begin, arguments)
    try:
        waiting = deque(workers.submit(_episode, index) for index in indices)
        for index in indices:
            yield _result(workers, waiting.popleft(), index)
    finally:
        workers.close()


def _result(workers: WorkerPool, job: PendingCall, index: int) -> dict[str, Any]:
    """The row of an episode; played again if its worker died, since equal seeds give equal rows."""
    for _ in range(workers.count + 2):  # all may have died at once
        try:
            row: dict[str, Any] = workers.result(job)
            return row
        except WorkerDiedError:
            _log.warning("a worker died and is replaced; episode %d is played again", index)
            job = workers.submit(_episode, index)
    raise FlipperctlError(f"episode {index} of the evaluation killed its worker again and again")


_player: Player | FlipperctlError | None = None  # one a worker process


def _begin(
    config: dict[str, Any], source: ControllerSource, seed: int, plugin_paths: list[str]
) -> None:
    global _player
    import torch

    torch.set_num_threads(1)
    try:
        plugins.load(plugin_paths)
        _player = Player(parse(EnvConfig, config), source, seed)
    except FlipperctlError as error:  # an initialiser's error would only break the pool
        _player = error


def _episode(index: int) -> dict[str, Any]:
    if not isinstance(_player, Player):
        raise _player or RuntimeError("the worker was not begun")
    return _player.episode(index)
