"""Who plays a training's episodes: actors in workers, and the collectors that ask them.

Out: one ``Step`` for each decision, episode after episode. ``InProcessCollector`` acts with the
newest weights (``train.mode=exact``). ``AsyncCollector`` keeps workers busy with requests for whole
episodes, so that acting and learning run in parallel (``train.mode=fast``).

The greedy episodes of a policy that is trained are equal, whichever process plays them. They use a
separate network on the CPU, since another device, or the learner's arrangement of its parameters,
rounds differently.
"""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors.numpy import load_file, save_file

from flipperctl.agent.frames import input_size
from flipperctl.agent.plain import PlainNetworks, Weights, split_weights
from flipperctl.api import Step
from flipperctl.config import RayCollector, TrainConfig, parse, to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.acting import Driving, TrainedPolicy, outputs_of
from flipperctl.rollout import cluster
from flipperctl.rollout.episode import (
    RolloutRequest,
    Row,
    exploration_rng,
    play,
)
from flipperctl.rollout.pool import POLL, Stop, WorkerDiedError, WorkerPool
from flipperctl.rollout.statement import Statement
from flipperctl.rollout.training import ConfiguredTraining

if TYPE_CHECKING:
    from flipperctl.agent.risk import Risk


@dataclass(frozen=True)
class Rollout:
    """An episode of a worker."""

    steps: list[Step]
    worker: str
    """Identifies the process."""
    waited: float
    """Time that it has waited for calls since its first one [s]."""
    elapsed: float
    """Time since its first call [s]."""


@dataclass(frozen=True)
class Usage:
    """How busy the learner and the workers of a training were."""

    workers: int
    learner_idle: float
    """Part of its time in which the learner waited for an episode."""
    workers_idle: float
    """Part of their time in which the workers waited for a request."""

    @property
    def enough(self) -> int:
        """Number of workers that would have played as much."""
        return max(1, math.ceil(self.workers * (1 - self.workers_idle)))

    def advice(self) -> str:
        """Return what bounds the training, and what would help."""
        if self.learner_idle > _IDLE:
            return "more workers would help" if self.workers_idle < _IDLE else ""
        text = "the learner is the bottleneck: more workers cannot help, "
        text += "several trainings side by side can"
        return text + (f"; {self.enough} is enough" if self.enough < self.workers else "")


_IDLE = 0.15
"""Part of the time from which the learner or the workers count as idle."""


class Stopwatch:
    """Measures how long a worker waits between its calls."""

    def __init__(self) -> None:
        self.name = f"{platform.node()} {os.getpid()}"
        self._begun = self._ended = time.perf_counter()
        self.waited = 0.0

    @property
    def elapsed(self) -> float:
        """Time since the first call [s]."""
        return self._ended - self._begun

    @contextmanager
    def call(self) -> Iterator[None]:
        """Measure the wait before a call."""
        now = time.perf_counter()
        # Before the first call the worker was starting up, not waiting.
        if self.elapsed:
            self.waited += now - self._ended
        else:
            self._begun = now
        yield
        self._ended = time.perf_counter()


class Actor:
    """Plays training episodes with the weights that come with each request."""

    def __init__(
        self,
        config: dict[str, Any],
        shared: Mapping[str, Any] | None = None,
        plain: PlainNetworks | None = None,
    ) -> None:
        """Build the environment and the networks of ``config``, a ``TrainConfig`` as plain data.

        ``shared``: what the learner's process shares, see ``flipperctl.api.Training``. ``plain``:
        what it drives with; None: the networks of torch.
        """
        parsed = parse(TrainConfig, config)
        self._training, self._seed = ConfiguredTraining(parsed, shared or {}), parsed.seed
        self._env = self._training.environment()
        self._greedy = GreedyPlayer(parsed, self._env, plain)
        # Weights, generator and decision come with each request, and are set in place.
        network: Any = plain.policy if plain else self._torch_network(parsed)
        self._network = outputs_of(network, joints=len(parsed.robot.joints))
        self._rng, self._decision = np.random.default_rng(), 0
        self._policy = parsed.agent.drive(
            self._training, network, lambda: self._decision, self._rng
        )

    def _torch_network(self, config: TrainConfig) -> Any:
        import torch

        # Workers fill the cores by their number; more threads each would only compete.
        torch.set_num_threads(1)
        return config.agent.driving_network(self._training).requires_grad_(False)

    def evaluate(self, weights: Weights, seed: int) -> Row:
        """Play the greedy episode of a seed; return its row."""
        self._greedy.load(weights)
        return self._greedy.play(seed)

    def play(self, request: RolloutRequest, weights: Weights) -> list[Step]:
        """Play one episode to its end; equal requests with equal weights give equal episodes."""
        self._network.load(weights)
        # Exploration follows from the episode's number, whichever worker plays it.
        rng = exploration_rng(self._seed, request.episode)
        self._rng.bit_generator.state = rng.bit_generator.state
        self._decision = request.decision
        played = self._training.steps(self._env, self._policy, request.seed, request.difficulty)
        return list(played)


class GreedyPlayer:
    """A policy network, and that of its risk, whose weights come with each request."""

    def __init__(
        self, config: TrainConfig, env: FlipperEnv, plain: PlainNetworks | None = None
    ) -> None:
        """``env`` plays the episodes; ``plain``: see ``Actor``."""
        network, risk = (plain.policy, plain.risk) if plain else _torch_networks(config)
        self._env, self._risk = env, risk
        frames, joints = config.network.frames, len(config.robot.joints)
        kind = config.actions
        self._policy = TrainedPolicy(network, frames, risk, kind=kind, joints=joints)
        self.network = self._policy.network

    def load(self, weights: Weights) -> None:
        """Take the weights of a policy and of its risk."""
        policy, risk = split_weights(weights)
        self.network.load(policy)
        if risk and self._risk is not None:
            self._risk.load(risk)

    def play(self, seed: int) -> Row:
        """Play the greedy episode of a seed; return its row."""
        self.network.begin(noise=False)
        return play(self._env, self._policy, seed)


def _torch_networks(config: TrainConfig) -> tuple[Driving, Risk | None]:
    import torch

    from flipperctl.agent.networks import build_policy
    from flipperctl.agent.risk import RiskNetwork, plain_risk

    layout, risk = config.perception.layout, config.agent.failure_risk
    with torch.random.fork_rng(devices=[]):  # the weights will come
        module = build_policy(config.network, layout, config.actions).requires_grad_(False)
        size = input_size(config.network, layout)
        return module, plain_risk(RiskNetwork(size), risk.horizon) if risk else None


_actor: Actor
_stopwatch: Stopwatch
"""The actor of this worker process, and what measures its waits."""


def create_actor(
    config: dict[str, Any],
    shared: Mapping[str, Any],
    plain: PlainNetworks | None,
    *statements: Statement,
) -> None:
    """Create the actor of this worker process, which agrees with the learner's ``statements``."""
    global _actor, _stopwatch
    for statement in statements:
        statement.enter()
    _actor, _stopwatch = Actor(config, shared, plain), Stopwatch()


def play_request(request: RolloutRequest, weights: Weights | Path) -> Rollout:
    """Let this process's actor play an episode, with weights that may lie in a file."""
    watch = _stopwatch
    with watch.call():
        played = _actor.play(request, _loaded(weights))
    return Rollout(played, watch.name, watch.waited, watch.elapsed)


def play_greedily(seed: int, weights: Weights | Path) -> Row:
    """Let this process's actor play a greedy episode, with weights that may lie in a file."""
    with _stopwatch.call():
        return _actor.evaluate(_loaded(weights), seed)


def _loaded(weights: Weights | Path) -> Weights:
    return load_file(weights) if isinstance(weights, Path) else weights


PlayHere = Callable[[int], Row]
"""Plays the greedy episode of a seed in this process."""


class InProcessCollector:
    """Plays in this process; the policy acts with the newest weights."""

    def __init__(self, play: Callable[[], Iterator[Step]], stop: Stop = lambda: False) -> None:
        """``play`` plays the next episode; ``stop`` can end an evaluation between two episodes."""
        self.episode, self._stop = play, stop

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], play_here: PlayHere
    ) -> list[Row] | None:
        """Play one greedy episode for each seed by ``play_here``; return the rows in their order.

        Returns None if the run is to stop before the last.
        """
        rows = []
        for seed in seeds:
            if self._stop():
                return None
            rows.append(play_here(seed))
        return rows

    def outstanding(self) -> list[RolloutRequest]:
        """Return an empty list: no episode is requested ahead of its use."""
        return []

    def usage(self) -> None:
        """Return None: there are no workers."""

    def close(self) -> None:
        """Do nothing: there are no workers."""


class RolloutWorkers:
    """Actors in processes of this machine; rollouts come in the order of the requests."""

    def __init__(
        self,
        count: int,
        config: TrainConfig,
        shared: Mapping[str, Any] | None = None,
        plain: PlainNetworks | None = None,
    ) -> None:
        """Create the actors, without waiting for them; ``shared``, ``plain``: see ``Actor``."""
        self._opened = ExitStack()
        self._sent: dict[Future[Rollout], RolloutRequest] = {}
        self._newest: dict[str, Rollout] = {}
        self._begun, self._waited = math.nan, 0.0  # first episode, and waits after it [s]
        self._shared: dict[int, Any] = {}
        """Weights as they are given to calls, by their versions."""
        # A worker with other code or files would play other episodes: each compares this first.
        inputs = Statement.of_inputs(config, config.network, config.teacher.controller)
        statements = Statement.of_code(), inputs
        self._torch = [] if plain else ["torch"]
        self._pool = self._open(count, (to_dict(config), dict(shared or {}), plain, *statements))

    def _open(self, count: int, arguments: tuple[Any, ...]) -> WorkerPool:
        # Weights go through files: a process that dies while it receives a long message would block
        # the interpreter's exit (CPython issue 94777, before Python 3.12).
        temporary = TemporaryDirectory(prefix="flipperctl-", ignore_cleanup_errors=True)
        self._folder = Path(self._opened.enter_context(temporary))
        return WorkerPool(count, create_actor, arguments, modules=self._torch)

    @property
    def capacity(self) -> int:
        """Number of requests that keeps all workers busy: each plays one while another waits."""
        return 2 * self._pool.count

    def send(self, request: RolloutRequest) -> None:
        """Send a request without waiting."""
        version = request.version
        # Requests of one version share their weights, which travel once.
        if version not in self._shared:
            self._shared[version] = self._share(f"request{version}", request.weights)
        light = replace(request, weights={})
        self._sent[self._pool.submit(play_request, light, self._shared[version])] = request

    def take(self, stop: Stop) -> tuple[RolloutRequest, list[Step] | None] | None:
        """Wait for a rollout; return its request with it, or with None if the worker died.

        Returns None alone, and keeps the request, if the run is to stop before one arrives.
        """
        # Poll, so that the wait can be stopped.
        start = time.perf_counter()
        while not (done := wait(self._awaited(), POLL, FIRST_COMPLETED).done):
            if stop():
                return None
        # Until the first episode the workers were starting up.
        now = time.perf_counter()
        if math.isnan(self._begun):
            self._begun = now
        else:
            self._waited += now - start
        future = done.pop()
        request = self._sent.pop(future)
        try:
            rollout = future.result()
            self._newest[rollout.worker] = rollout
            return request, rollout.steps
        except WorkerDiedError:
            return request, None
        finally:
            # Weights that no outstanding request refers to are given up.
            for version in self._shared.keys() - {
                rollout.version for rollout in self.outstanding()
            }:
                self._forget(self._shared.pop(version))

    def _awaited(self) -> Iterable[Future[Rollout]]:
        return [next(iter(self._sent))]

    def _share(self, name: str, weights: Weights) -> Any:
        path = self._folder / f"{name}.safetensors"
        save_file(dict(weights), path)
        return path

    def _forget(self, shared: Any) -> None:
        shared.unlink()

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Future[Row]]:
        """Request one greedy episode for each seed, without waiting; see ``WorkerPool.submit``."""
        shared = self._share("evaluated", weights)
        return [self._pool.submit(play_greedily, seed, shared) for seed in seeds]

    def usage(self) -> Usage | None:
        """Return how busy learner and workers were; None before the second episode."""
        newest = self._newest.values()
        elapsed, passed = sum(r.elapsed for r in newest), time.perf_counter() - self._begun
        if not (elapsed and passed > 0):
            return None
        idle = sum(r.waited for r in newest) / elapsed
        return Usage(self._pool.count, round(self._waited / passed, 3), round(idle, 3))

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent but not yet taken, oldest first."""
        return list(self._sent.values())

    def close(self) -> None:
        """Stop the workers and delete their files."""
        self._pool.close()
        self._opened.close()


class RayWorkers(RolloutWorkers):
    """Actors on a Ray cluster; rollouts come as soon as they are ready."""

    def __init__(
        self,
        settings: RayCollector,
        config: TrainConfig,
        shared: Mapping[str, Any] | None = None,
        report: Callable[[str], None] = lambda text: None,
        plain: PlainNetworks | None = None,
    ) -> None:
        """Create the actors, without waiting; ``report`` gets sentences about them."""
        self._settings, self._report = settings, report
        super().__init__(settings.workers, config, shared, plain)

    def _open(self, count: int, arguments: tuple[Any, ...]) -> WorkerPool:
        address = self._settings.address or cluster.LOCAL
        self._opened.enter_context(cluster.connected(address, "collector.address", count))
        self._hosts = cluster.Hosts(count, self._settings.patience)
        return WorkerPool(count, create_actor, arguments, self._hosts.start)

    @property
    def capacity(self) -> int:
        """Number of requests that keeps all started workers busy."""
        return 2 * max(1, self._hosts.started)

    def _awaited(self) -> Iterable[Future[Rollout]]:
        while not self._hosts.notes.empty():
            self._report(self._hosts.notes.get())
        return self._sent

    def _share(self, name: str, weights: Weights) -> Any:
        return cluster.import_ray().put(dict(weights))  # sent once to each machine

    def _forget(self, shared: Any) -> None:
        """Ray forgets what nothing refers to."""


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
        """``on_lost`` is called with each request whose worker died.

        ``accept`` returns whether the rollout of a request is still used; ``stop`` ends any wait.
        """
        self._workers, self._next_request = workers, next_request
        self._on_lost, self._accept, self._stop = on_lost, accept, stop
        self.outstanding, self.close = workers.outstanding, workers.close
        self.usage = workers.usage

    def episode(self) -> Iterator[Step]:
        """Yield the steps of the next episode that the workers return; none if the run stops."""
        workers = self._workers
        while True:
            # Keep the workers busy before waiting for the next rollout.
            while len(workers.outstanding()) < workers.capacity:
                workers.send(self._next_request())
            taken = workers.take(self._stop)
            if taken is None:
                return
            request, rollout = taken
            # The episode of a lost request is dropped, as is one too old to learn from.
            if rollout is None:
                self._on_lost(request)
            elif self._accept(request):
                break
        yield from rollout

    def evaluate(
        self, weights: Weights, seeds: Sequence[int], play_here: PlayHere
    ) -> list[Row] | None:
        """Play one episode for each seed: workers from the first on, this process from the last.

        Returns the rows in the order of the seeds; None if the run is to stop before the last.
        """
        futures = self._workers.evaluate(weights, seeds)
        rows: list[Row] = []
        # Workers begin with the first seed, this process with the last, until they meet.
        for future, seed in zip(reversed(futures), reversed(seeds), strict=True):
            row = self._row(future, seed, play_here)
            if row is None:
                for other in futures:
                    other.cancel()
                return None
            rows.append(row)
        return rows[::-1]

    def _row(self, future: Future[Row], seed: int, play_here: PlayHere) -> Row | None:
        """Return the row of an episode, played here if no worker has begun it; None to stop."""
        if self._stop():
            return None
        # A call that can still be cancelled was begun by nobody.
        if future.cancel():
            return play_here(seed)
        while not wait([future], POLL).done:
            if self._stop():
                return None
        try:
            return future.result()
        except WorkerDiedError:
            return play_here(seed)


Collector = InProcessCollector | AsyncCollector
"""Plays training episodes: ``episode`` yields the steps of a whole one, none if the run stops."""
