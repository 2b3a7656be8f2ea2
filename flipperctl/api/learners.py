"""Learners: what a training is to its learner, and a learner to the trainer.

A learner's fields are its settings. It builds a ``Learning`` for a run, which takes in one ``Step``
after the other and has a policy, and it says what drives the episodes of training. The trainer
plays, validates, saves and resumes; it knows no learner but by this contract.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from flipperctl.api.controllers import Network, Policy, StateGroups
from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import ObservationLayout
from flipperctl.core.risk import EscapeRule
from flipperctl.core.targets import Action, ActionKind

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Step:
    """One decision of a training episode; observations are the network's inputs, (frames · n,)."""

    observation: NDArray[np.float32]
    action: Action
    """Index of the action, or the rates of all joints, by the kind of actions."""
    reward: float
    next_observation: NDArray[np.float32]
    ending: Mapping[str, Any] | None
    """``seed``, ``outcome``, metrics and difficulty after the episode's last step; None before."""
    # What drove, if it was a teacher or explored.
    label: NDArray[np.float32] | None = None
    """The ``label`` of what drove, such as a distribution over actions, (9,), if it has one."""
    groups: StateGroups | None = None
    """After the last step, the states that a teacher valued on the episode's ground."""
    explored: bool = False
    """Whether the action was random."""
    # What only a simulation knows.
    privileged: NDArray[np.float32] | None = None
    """Privileged state at ``observation``, (P,), if the learner asks for them."""
    next_privileged: NDArray[np.float32] | None = None
    """Privileged state at ``next_observation``, (P,)."""


class Training(Protocol):
    """A training as its learner sees it, in the learner's process and in that of each worker."""

    config: Any
    """The whole configuration; its sections are attributes, as in ``config.rewards``."""
    layout: ObservationLayout
    network: Network
    actions: ActionKind
    """``turns`` or ``rates``."""
    decisions: int
    """Budget of the run."""
    seed: int
    """Seed of the first weights, below 2^32."""
    device: str
    generators: dict[str, np.random.Generator]
    """Generators of the learner's process by name; checkpoints hold their states. ``sample`` is for
    its batches, ``explore`` for what drives here; the learner may add others."""
    shared: dict[str, Any]
    """Plain data that the learner's process passes to the workers' ones before they begin."""

    def policy_network(self) -> torch.nn.Module:
        """Return the policy's network with random first weights, which ``seed`` determines.

        It maps observations (B, frames · n) to Q-values (B, 3^J) or rates (B, J) from -1 to 1.
        """

    def environment(self) -> Any:
        """Return a new environment of the training, as ``gymnasium.make`` does."""

    def report(self, text: str) -> None:
        """Show the user a sentence."""


class Loop(Protocol):
    """The run, for a learner that plays its episodes itself."""

    @property
    def decision(self) -> int:
        """Number of decisions of the run so far."""

    def begin_episode(self) -> tuple[int, float]:
        """Return seed and difficulty of the next episode."""

    def count_decision(self) -> None:
        """Count a decision."""

    def end_episode(self, ending: Mapping[str, Any]) -> None:
        """Take in the seed, the outcome and the metrics of an episode that has ended."""

    def between_episodes(self) -> bool:
        """Validate and save what is due; return False if the run is to stop."""


class Learning(ABC):
    """What a learner has in one run: networks, memory, counters."""

    # Networks.
    policy: torch.nn.Module
    """The network that is validated and exported, of the shape of ``Training.policy_network``."""
    driving: torch.nn.Module
    """The network whose weights drive training episodes; see ``Learner.driving_network``."""
    risk: torch.nn.Module | None = None
    """The network of the policy's risk, a ``flipperctl.agent.risk.RiskNetwork``, if it learns
    one; see ``Learner.failure_risk``."""
    # Progress.
    updates: int = 0
    """Number of updates so far; workers get new weights when it has changed."""
    loss: float = 0.0
    """Loss of the last update."""

    # The course of a run.
    def begin(self) -> None:  # noqa: B027  # most have nothing to do
        """Begin a new training; a resumed one is restored instead."""

    @abstractmethod
    def add(self, step: Step, decision: int) -> None:
        """Take in a decision, and update if that is due.

        ``decision``: number of decisions of the run, this one included.
        """

    def end_episode(self, decision: int) -> None:  # noqa: B027  # likewise
        """Learn from the episode that the last step ended, if that is due."""

    def drop_episode(self) -> None:  # noqa: B027  # likewise
        """Discard what the running episode left incomplete; it will have no end."""

    def finish(self, stop: Callable[[], bool]) -> bool:
        """Learn after the last decision; return False if ``stop`` returned True meanwhile."""
        return True

    def exploration(self, decision: int) -> float | None:
        """Return the probability of a random action, for ``metrics.csv``; None without one."""
        return None

    # State for checkpoints.
    @abstractmethod
    def tensors(self) -> Mapping[str, Mapping[str, torch.Tensor]]:
        """Return the state by part and name, between episodes.

        The part ``target`` is the ``state_dict`` of the policy, which the trainer adds if it is
        missing; ``risk`` is the one of the risk.
        """

    @abstractmethod
    def counters(self) -> Mapping[str, Any]:
        """Return the rest of the state as JSON types."""

    @abstractmethod
    def restore(
        self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
    ) -> None:
        """Restore what ``tensors`` and ``counters`` returned, and the policy of ``target``.

        ``updates`` and ``loss`` are restored before.

        Raises:
            ValueError: they do not fit this training.
        """

    def train(self, loop: Loop) -> bool:
        """Play and learn to the end of the budget; return False if the run stops before.

        Called instead of ``add`` for a learner with ``own_loop``.
        """
        raise TypeError(f"{type(self).__name__} has no loop of its own")


@dataclass(frozen=True)
class FailureRisk:
    """How a learner's risk counts and is used."""

    horizon: int
    """Decisions before the end of a failed episode that count as about to fail [-]."""
    false_alarms: float
    """Largest share of the reached validation episodes in which the policy may warn [-]."""
    escape: EscapeRule | None
    """How the policy draws its actions while it warns; None if it never does."""


class Learner(Plugin, ABC):
    """The frozen settings of a way to learn."""

    kind: ClassVar[str] = "agent"
    # What this kind of learner can do.
    takes_teacher: ClassVar[bool] = False
    """Whether it learns from the labels and recorded episodes of the section ``teacher``."""
    own_loop: ClassVar[bool] = False
    """Whether its ``Learning`` plays the episodes itself, by ``train``."""
    # What commands and checkpoints need to know of it.
    default_network: ClassVar[str] = ""
    """Name of the network that ``agent=NAME`` chooses with it; empty: none."""
    drives_by_outputs: ClassVar[bool] = False
    """Whether ``Learning.driving`` is a network as the policy's, of which ``drive`` needs the
    outputs alone, as the policies of ``flipperctl.policies.acting`` do. Workers without torch then
    call it with an ``agent.plain.PlainNetwork``."""
    resumes_exactly: ClassVar[bool] = True
    """Whether a stopped training goes on bit for bit."""
    short: ClassVar[Mapping[str, Any]] = {}
    """Settings with which the conformance suite trains it for some dozens of decisions; whole
    numbers are small there unless they stand here."""
    packages: ClassVar[tuple[str, ...]] = ()
    """Packages whose versions checkpoints state."""

    gamma: float = Field(0.99, ge=0, lt=1, description="discount per decision [-]")

    @property
    def drives(self) -> tuple[ActionKind, ...]:
        """Kinds of actions that its policies take."""
        return ("turns",)

    @property
    def failure_risk(self) -> FailureRisk | None:
        """Settings of the risk that comes with its policies; None without a risk."""
        return None

    @property
    def value_scale(self) -> float | None:
        """Factor from returns to the outputs of its policies; None if they estimate no returns."""
        return None

    @classmethod
    def arguments(cls) -> Iterable[tuple[str, Any]]:
        """Yield what ``explain`` and ``list`` know of keys in its mappings, if there are any.

        Each is the overrides that choose what has the key, and a ``config.describe.Field`` whose
        name is the key below ``agent``.
        """
        return ()

    # Before a run.
    def check(self, config: Any) -> None:
        """Check the settings against the rest of the training's configuration.

        Raises:
            ValueError: they do not go together; the text begins with the key.
        """

    def check_start(self, config: Any) -> None:
        """Check files, memory and packages before a new training begins; see ``check``."""

    def first_update(self, config: Any) -> tuple[int, str] | None:
        """Return the decisions before the policy first changes, and a clause that says why.

        None: it may change from the start. A training with fewer decisions says so at its start.
        """
        return None

    # In a run.
    def privileged(self, config: Any) -> bool:
        """Return whether the steps shall have privileged states."""
        return False

    @abstractmethod
    def build(self, training: Training) -> Learning:
        """Return what learns in a new run, or in one that is restored afterwards."""

    def driving_network(self, training: Training) -> torch.nn.Module:
        """Return a network that takes the weights of ``Learning.driving`` in a worker."""
        return training.policy_network()

    @abstractmethod
    def drive(
        self,
        training: Training,
        module: torch.nn.Module,
        decision: Callable[[], int],
        rng: np.random.Generator,
    ) -> Policy:
        """Return the policy of training episodes; called once in each process that plays some.

        ``module``: ``Learning.driving``, or a worker's network with its weights, which change
        between episodes. ``decision`` returns the decisions of the run so far, in a worker at the
        time when the episode was requested. ``rng`` is the only source of random numbers. The
        policy's attributes ``label``, ``groups`` and ``explored`` after ``act`` come with each
        step.
        """


LearnerT = TypeVar("LearnerT", bound=Learner)


def learner(name: str) -> Callable[[type[LearnerT]], type[LearnerT]]:
    """Register a ``Learner``; choose it with ``agent=<name>``."""
    return register(Learner, name)
