"""Play one policy on one scene, decision by decision, for a viewer that shows it later.

In: a configuration, a policy and a seed. Out: the states every ``PERIOD`` of each decision, what
the policy perceived, and its values. The simulation never waits for the viewer within a decision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Outcome, Policy, RobotState, World
from flipperctl.config import EvalConfig
from flipperctl.core.targets import actions_of, angles_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.lookahead.search import Planned
from flipperctl.rollout.episode import Decision, decisions

_EVERY = 4
"""Samples between two states [-]."""
PERIOD = _EVERY * SAMPLE_PERIOD
"""Time between two states [s]."""


@dataclass(frozen=True)
class Episode:
    """What an episode is played from."""

    config: EvalConfig
    policy: Policy
    seed: int
    policy_name: str = ""
    """Name of the policy of a recorded episode; empty: the entrant's label."""
    number: int | None = None
    """Index of a recorded episode within its evaluation."""


@dataclass(frozen=True)
class Entrant:
    """A policy with its episodes."""

    label: str
    episode: Callable[[int], Episode]
    """Returns the episode with an index from 0; its policy is built anew, so that a viewer of a
    running training sees the newest weights."""
    recorded: bool = False
    """Whether the episodes are recorded ones, each of a draw of its own."""


@dataclass
class Moment:
    """One decision as a viewer shows it."""

    states: list[RobotState]
    """States every ``PERIOD`` since the decision before; at the start, the initial state alone."""
    decision: Decision | None
    """None at the start of an episode."""
    values: FloatArray | None = None
    """Q-values of the observation, (9,); None for a policy without them."""
    risk: float | None = None
    """Probability of a failure, by the policy [-]; None for a policy without it."""
    planned: Planned | None = None
    """What the policy planned before the decision; None for a policy without plans."""


_TURNS = {-1: "down", 0: "hold", 1: "up"}


def by_ends(joints: Sequence[str]) -> tuple[str, str]:
    """Return texts of J joints as those of front and rear, left before right."""
    half = len(joints) // 2
    return "/".join(joints[:half]), "/".join(joints[half:])


def action_text(decision: Decision) -> tuple[str, str]:
    """Return how an action turns front and rear."""
    if decision.rates is not None:
        return by_ends([f"{rate:+.2f}" for rate in decision.rates])
    turns = actions_of(decision.transition.flippers.shape[1])[decision.action]
    return by_ends([_TURNS[turn] for turn in turns])


@dataclass
class History:
    """What has been shown of an episode, for plots."""

    times: list[float] = field(default_factory=list)
    """Time of each decision [s]."""
    rewards: dict[str, list[float]] = field(default_factory=dict)
    """Weighted value of each reward term at each decision."""
    risks: list[float] = field(default_factory=list)
    angle_times: list[float] = field(default_factory=list)
    """Time of each state [s]."""
    angles: list[tuple[float, ...]] = field(default_factory=list)
    """Pitch, angle of each joint, and roll at each state, (2 + J,) [rad]."""
    variation: float = 0.0
    """Pitch variation so far, at 100 Hz [rad]."""

    def add(self, moment: Moment) -> None:
        """Add a moment that is being shown."""
        self.angle_times += [state.time for state in moment.states]
        self.angles += [(s.pitch, *angles_of(s), s.roll) for s in moment.states]
        if (decision := moment.decision) is not None:
            self.times.append(decision.transition.after.time)
            for name, value in decision.rewards.items():
                self.rewards.setdefault(name, []).append(value)
            if moment.risk is not None:
                self.risks.append(moment.risk)
            self.variation += float(np.abs(np.diff(decision.poses[:, 2])).sum())


class _States(Observer):
    every = _EVERY

    def __init__(self) -> None:
        self.states: list[RobotState] = []

    def stopped(self, world: World) -> None:
        self.states.append(world.state())

    def take(self) -> list[RobotState]:
        taken, self.states = self.states, []
        return taken


class Lane:
    """The episodes of one policy on one scene, one after the other."""

    def __init__(
        self, entrant: Entrant, report: Callable[[float], None] = lambda fraction: None
    ) -> None:
        """``report`` is called with the completed fraction of a search before an episode."""
        self.entrant, self._report = entrant, report
        self.history = History()
        self.outcome: Outcome | None = None
        """How the episode ended; None while it runs."""
        self.env: FlipperEnv
        """The environment of the episode."""
        self.label = entrant.label
        """Name of the policy of the episode."""
        self.title = ""
        """Ground and index of the episode."""
        self._moments: Iterator[Moment] = iter(())

    def begin(self, index: int, difficulty: float = 1.0, seed: int | None = None) -> Moment:
        """Begin the episode with this index, or its scene drawn by ``seed``; return its start."""
        self.history, self.outcome = History(), None
        episode = self.entrant.episode(index)
        if seed is not None:
            episode = replace(episode, seed=seed)
        self.env = FlipperEnv(config=episode.config)
        self._moments = self._played(episode, difficulty)
        first = next(self._moments)
        number = index if episode.number is None else episode.number
        drawn = f"seed {seed}" if seed is not None else f"episode {number}"
        self.title = f"{episode.config.terrain.title}, {drawn}"
        self.label = episode.policy_name or self.entrant.label
        self.history.add(first)
        return first

    def step(self) -> Moment | None:
        """Simulate one decision; None once the episode has ended."""
        moment = next(self._moments, None)
        if moment is not None:
            self.history.add(moment)
            assert moment.decision is not None  # only ``begin`` takes the start
            self.outcome = moment.decision.transition.outcome
        return moment

    def _played(self, episode: Episode, difficulty: float) -> Iterator[Moment]:
        seen, policy = _States(), episode.policy
        rates = getattr(policy, "kind", "turns") == "rates"
        values = None if rates else getattr(policy, "q_values", None)
        self.env.reset(seed=episode.seed, options={"difficulty": difficulty})
        yield Moment([self.env.state], None)
        played = decisions(
            self.env, policy, episode.seed, difficulty=difficulty, observers=[seen],
            report_progress=self._report,
        )  # fmt: skip
        for decision in played:
            states = [state for state in seen.take() if state.time > 0]  # the start was shown
            # The last state is shown, though it may lie between two instants.
            if decision.ending is not None:
                states.append(decision.transition.after)
            yield Moment(
                states,
                decision,
                None if values is None else np.array(values(decision.perception)),
                getattr(policy, "risk", None),
                getattr(policy, "planned", None),
            )
