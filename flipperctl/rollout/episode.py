"""The one episode loop, what is learnt and recorded of an episode, and the seeds of episodes.

In: an environment, a policy, a seed. Out: one ``Decision``, or one ``Step`` of a learner, after the
other; a ``RecordedEpisode`` for a file. Each is made on request of the iterator, so that the caller
can learn, display, wait or stop in between.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.agent.plain import Weights
from flipperctl.api import (
    FloatArray,
    Outcome,
    Perception,
    Policy,
    RecordedEpisode,
    Robot,
    Step,
    Terrain,
    Transition,
)
from flipperctl.config import identity
from flipperctl.core.risk import RiskSign
from flipperctl.core.targets import Rates, allowed, as_action
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.env.privileged import PrivilegedStates
from flipperctl.errors import FlipperctlError
from flipperctl.rollout.risks import EpisodeRisks
from flipperctl.sim.versions import samples_in


class EpisodeRecorder:
    """Collects the decisions of one episode at a time."""

    def __init__(self, robot: Robot) -> None:
        """Record episodes of ``robot``."""
        self._no_label = np.zeros(3 ** len(robot.joints), np.float32)
        self._observations: list[NDArray[np.float32]] = []
        self._decisions: list[tuple[int, float, NDArray[np.float32]]] = []
        self._commands: list[FloatArray] = []

    def add(
        self,
        observation: NDArray[np.float32],
        action: int,
        reward: float,
        next_observation: NDArray[np.float32],
        label: NDArray[np.float32] | None,
        commands: FloatArray | None = None,
    ) -> None:
        """Add a decision; the observations are of single instants, (n,) in SI units.

        ``commands``: an operator's commands, (K, 5) or of four flippers (K, 9).
        """
        if not self._decisions:
            self._observations.append(observation)
        self._observations.append(next_observation)
        self._decisions.append((action, reward, self._no_label if label is None else label))
        if commands is not None:
            self._commands.append(commands)

    def drop(self) -> None:
        """Discard the running episode."""
        self._observations, self._decisions, self._commands = [], [], []

    def finish(self, number: int, ending: Row) -> RecordedEpisode:
        """Return the episode that the last decision ended; begin the next one.

        ``number`` counts episodes from 0; ``ending`` has the seed, outcome and terrain.
        """
        # The recorder is emptied before the episode is built, so that an error leaves no remains.
        actions, rewards, labels = zip(*self._decisions, strict=True)
        observations = np.array(self._observations, np.float32)
        commands = np.concatenate(self._commands) if self._commands else None
        self.drop()
        return RecordedEpisode(
            number=number,
            seed=ending["seed"],
            terrain=ending["terrain"],
            outcome=Outcome(ending["outcome"]),
            observations=observations,
            actions=np.array(actions, np.int64),
            rewards=np.array(rewards, np.float64),
            labels=np.array(labels, np.float32),
            commands=commands,
        )


Row = dict[str, Any]
"""Seed, outcome and metrics of one episode."""
SEARCH = "search_"
"""Prefix of the keys of a policy's search results."""


@dataclass(frozen=True)
class Decision:
    """One decision and its results."""

    perception: Perception
    action: int
    """Index of the action; of rates and of an operator, the one that came closest."""
    rates: Rates | None
    """Rates of the action; None of an index and of an operator."""
    reward: float
    """Sum of ``rewards``, the weighted value of each reward term."""
    rewards: Mapping[str, float]
    transition: Transition
    """True states before and after the decision, with the poses between at 100 Hz."""
    next_perception: Perception
    ending: Row | None
    """Seed, outcome and metrics of the episode after its last decision; None before."""

    @property
    def poses(self) -> FloatArray:
        """Poses (S + 1, 3 + J) every 10 ms: x [m], z [m], pitch and flipper angles [rad]."""
        return np.column_stack([self.transition.path, self.transition.flippers])


def decisions(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    difficulty: float = 1.0,
    pace: Callable[[float], None] | None = None,
    report_progress: Callable[[float], None] = lambda fraction: None,
    observers: Sequence[Observer] = (),
) -> Iterator[Decision]:
    """Yield the decisions of one whole episode; stop iterating to cancel it.

    ``difficulty``: difficulty of the terrain, 0 to 1. ``pace`` is called before each decision with
    the time since the start of the episode [s], and may wait. ``report_progress`` is called with
    the completed fraction of the search by a policy that searches before it acts. ``observers`` see
    the episode's samples, measurements and decisions.
    """
    # Observers are set before the reset, so that they see the start.
    env.observers = tuple(observers)
    env.reset(seed=seed, options={"difficulty": difficulty})
    simulator, joints = env.simulator(report_progress), len(env.robot.joints)
    policy.reset(simulator)
    # An operator commands between decisions as well, with the period of its own.
    if (period := getattr(policy, "command_period", None)) is not None:
        operator: Any = policy
        env.drive.operate(samples_in(period), operator.command)
    ending: Row | None = None
    sign: RiskSign | None = getattr(policy, "risk_sign", None)
    risks: list[float] = []
    while ending is None:
        if pace is not None:
            pace(env.state.time)
        perception = env.perception
        action = policy.act(perception)
        if as_action(action, joints) is None:
            text = f"{type(policy).__name__}.act returned {action!r}; {allowed(joints)}"
            raise FlipperctlError(text)
        # A policy computes its risk as part of acting.
        if sign is not None and (risk := getattr(policy, "risk", None)) is not None:
            risks.append(risk)
        _, reward, terminated, truncated, info = env.step(action)
        # The last decision brings the row of the whole episode.
        if terminated or truncated:
            ending = {"seed": seed, "outcome": str(info["outcome"]), **info["metrics"]}
            ending |= {f"{SEARCH}{name}": value for name, value in simulator.results.items()}
            if sign is not None:
                ending |= EpisodeRisks.of(sign, risks).to_row()
        yield Decision(
            perception=perception,
            action=env.drive.action,
            rates=env.drive.rates,
            reward=reward,
            rewards=info["rewards"],
            transition=env.transition,
            next_perception=env.perception,
            ending=ending,
        )


def play(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    watch: Callable[[Decision], None] = lambda decision: None,
    report_progress: Callable[[float], None] = lambda fraction: None,
    observers: Sequence[Observer] = (),
) -> Row:
    """Play one episode to its end; return its seed, outcome and metrics.

    ``watch`` is called after each decision; ``observers`` also see the samples between decisions.
    """
    ending: Row | None = None
    played = decisions(env, policy, seed, report_progress=report_progress, observers=observers)
    for decision in played:
        watch(decision)
        ending = decision.ending
    assert ending is not None  # decisions() yields until there is one
    return ending


@dataclass(frozen=True)
class RolloutRequest:
    """All that a worker needs to play one training episode."""

    episode: int
    """Number of the episode in the run, from 0."""
    seed: int
    decision: int
    """Decisions of the run at the time of the request."""
    version: int
    """Number of updates before the weights; requests of one version share their weights."""
    weights: Weights
    difficulty: float = 1.0
    """Difficulty of the terrain, 0 to 1."""


def steps(
    env: FlipperEnv,
    policy: Policy,
    seed: int,
    *,
    difficulty: float = 1.0,
    frames: int = 1,
    privileged: bool = False,
) -> Iterator[Step]:
    """Yield the steps of one episode; each is made on request of the iterator.

    ``frames``: number of observations that the network takes as one input. ``privileged``: whether
    the steps have privileged states.
    """
    states = PrivilegedStates(env) if privileged else None
    before: NDArray[np.float32] | None = None
    for d in decisions(env, policy, seed, difficulty=difficulty):
        # The next observation of this step is the observation of the one that follows.
        after = stacked(d.next_perception.recent, frames)
        if states is not None:
            states.add(d.transition)
        yield Step(
            observation=stacked(d.perception.recent, frames) if before is None else before,
            action=d.action if d.rates is None else d.rates,
            reward=d.reward,
            next_observation=after,
            ending=None if d.ending is None else {**d.ending, "difficulty": difficulty},
            label=getattr(policy, "label", None),
            groups=None if d.ending is None else getattr(policy, "groups", None),
            explored=getattr(policy, "explored", False),
            privileged=None if states is None else states.rows[-2],
            next_privileged=None if states is None else states.rows[-1],
        )
        before = after


# Seeds lie in three streams with disjoint ranges. Those of trainings have 32 bits; those of
# validations and evaluations are the stream's number followed by 50 random bits, below 2^53, so
# that every JSON reader keeps all their digits.
_TRAINING, _VALIDATION, _EVALUATION, _EXPLORATION = 1, 2, 3, 4
_RANDOM_BITS = 50


def training_seed(seed: int, episode: int) -> int:
    """Return the seed of a training episode, below 2^32; ``seed`` is that of the training."""
    return int(_sequence(seed, _TRAINING, episode).generate_state(1, np.uint32)[0])


def validation_seed(seed: int, episode: int) -> int:
    """Return the seed of a validation episode, from 2^51 on; ``seed`` is that of validations."""
    return _long_seed(_VALIDATION, seed, episode)


@dataclass(frozen=True)
class EvaluationSeeds:
    """The seeds of an evaluation's episodes on one terrain, from 3 · 2^50 on.

    Equal arguments give equal seeds on every machine. The seeds of two terrains differ, so that
    episodes on several terrains are independent samples. Physics, sensing, start, engine and policy
    do not influence the seeds, so that all of them meet the same ground.
    """

    seed: int
    """Seed of the evaluation."""
    terrain: tuple[int, ...]
    """Four 32-bit words of the SHA-256 of the terrain's ``config.identity``."""

    @classmethod
    def of(cls, seed: int, terrain: Terrain) -> EvaluationSeeds:
        """Return the seeds of an evaluation on a terrain."""
        # Sorted keys and little-endian words: equal digests on every machine.
        text = json.dumps(identity(terrain), sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(text.encode()).digest()
        return cls(seed, tuple(np.frombuffer(digest[:16], "<u4").tolist()))

    def __call__(self, episode: int) -> int:
        """Return the seed of an episode, counted from 0."""
        return _long_seed(_EVALUATION, self.seed, *self.terrain, episode)

    def first(self, count: int) -> list[int]:
        """Return the seeds of the first episodes."""
        return [self(episode) for episode in range(count)]


def exploration_rng(seed: int, episode: int) -> np.random.Generator:
    """Return the generator of a worker's exploration in one training episode."""
    return np.random.default_rng(_sequence(seed, _EXPLORATION, episode))


def _long_seed(stream: int, seed: int, *key: int) -> int:
    (word,) = _sequence(seed, stream, *key).generate_state(1, np.uint64)
    return (stream << _RANDOM_BITS) | (int(word) >> (64 - _RANDOM_BITS))


def _sequence(seed: int, stream: int, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(stream, *key))
