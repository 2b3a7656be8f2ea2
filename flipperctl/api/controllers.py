"""What decides: Q-networks, and controllers with the policies that they build.

Policies that look ahead are given a simulator, and students the values of a teacher's actions.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.rewards import RewardTerm
from flipperctl.api.robot import Robot
from flipperctl.api.values import (
    ObservationLayout,
    Outcome,
    Perception,
    RecordedEpisode,
    RobotGeometry,
    RobotState,
)
from flipperctl.core import FloatArray
from flipperctl.core.targets import Action, ActionKind

if TYPE_CHECKING:
    import torch


class Simulator(Protocol):
    """A copy of an episode's scene for policies that look ahead; it exists in simulation only."""

    @property
    def state(self) -> RobotState:
        """Current state of the robot."""

    @property
    def robot(self) -> RobotGeometry:
        """Geometry of the robot."""

    @property
    def speed(self) -> float:
        """Speed of the belts [m/s]."""

    seed: int | None
    """Seed of the episode, which identifies a recorded one; None: the episode has no seed."""

    @property
    def finish(self) -> float:
        """World x that the chassis centre must pass [m]."""

    @property
    def profile(self) -> Profile:
        """True ground of the episode."""

    @property
    def poses(self) -> FloatArray:
        """Poses of the last decision at 100 Hz, the pose before it first, (S + 1, 5).

        Columns: x [m], z [m], pitch, front and rear flipper angle [rad].
        """

    # Decisions, as the policy would meet them.
    def step(self, action: Action) -> Outcome | None:
        """Simulate one decision; return the outcome, or None while the episode runs.

        ``action``: as a rule returns it, an index of pairs, or rates.
        """

    def perceive(self) -> Perception:
        """Return the policy's current perception.

        Call it once after ``restart`` and once after each ``step``. It then returns the perceptions
        of the episode itself, noise included: a policy takes the same actions in the simulator as
        in the episode.
        """

    def perceive_exactly(self) -> Perception:
        """Return the perception of a sensor without errors and delay, with the sampled physics.

        It has the ``robot`` and the ``friction`` of the episode; ``friction`` is None if the engine
        has none. Call it like ``perceive``: once after ``restart`` and once after each ``step``.
        """

    # Snapshots, and the start.
    def save(self) -> Any:
        """Return a snapshot of the scene for ``load``.

        It includes the sensor's state, its noise generators and the recent observations.
        """

    def load(self, saved: Any) -> None:
        """Restore a snapshot.

        The engine's contact impulses are not restored, so a trajectory through loaded snapshots
        differs slightly from the same actions without interruption.
        """

    def restart(self) -> None:
        """Return to the start, from which equal actions reproduce the episode's states exactly."""

    # Reports about a search.
    def report_progress(self, fraction: float) -> None:
        """Report the completed fraction of a long search, in [0, 1]."""

    def report_result(self, **values: float | str) -> None:
        """Report numbers and texts about the search, to be added to the episode's result."""


class Policy(Protocol):
    """Chooses the actions of an episode; it may keep state.

    Trained networks, exported files, rules, planners and human drivers are all policies.

    One that commands more often than it decides has ``command_period``, a time [s], and
    ``command``, which returns a ``Command``. It is called with the world at the start of each
    decision and after each period in it. What ``act`` returns then has no effect: the action that
    counts is the one that comes closest to the commands.
    """

    def reset(self, simulator: Simulator, /) -> None:
        """Begin an episode; ``simulator`` simulates its scene for policies that look ahead."""

    def act(self, p: Perception, /) -> Action:
        """Return the next action: an index into ``ACTIONS``, or rates.

        Rates are the turns of the front and the rear pair, each from -1 to 1 angle steps.
        """


@runtime_checkable
class CostPolicy(Policy, Protocol):
    """A policy that also returns the cost of each action, for teaching more than its own choice.

    A decision is either one call of ``act``, or one call of ``costs`` followed by one of ``took``.
    """

    def costs(self, p: Perception, /) -> FloatArray:
        """Return the cost of each action of ``ACTIONS``, (9,), or of J joints, (3^J,) [s].

        The cost is that of the cheapest known behaviour that begins with the action. Every cost is
        finite; an action without a known behaviour has a cost far above the others.
        """

    def took(self, action: int, /) -> None:
        """Receive the action that was taken after ``costs``, the cheapest or any other."""


class ValuedPolicy(Policy, Protocol):
    """A policy of a file: trained, exported or shipped."""

    kind: ActionKind
    """``turns``, by a Q-value of each action, or ``rates``, which have none."""

    def q_values(self, p: Perception, /) -> Sequence[float]:
        """Return the Q-values, (9,)."""


TOLERANCE = 0.02
"""Largest relative difference of a dimension that was not randomised in the training [-]."""


@dataclass(frozen=True)
class LearnedValue:
    """The value of a trained policy, with which a search can end its plans."""

    value: Callable[[NDArray[np.float32]], FloatArray]
    """Returns the expected discounted return from observations (M, n), (M,) [-]."""
    rewards: Mapping[str, RewardTerm]
    """Reward terms that it was trained with."""
    gamma: float
    """Discount per decision [-]."""
    layout: ObservationLayout
    """Layout of its observations."""
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Smallest and largest dimension of the robots of its training, by field of ``RobotGeometry``
    [m, rad]; a missing dimension may have any size."""

    def misfits(self, robot: RobotGeometry, layout: ObservationLayout) -> Iterator[str]:
        """Yield each property of a robot and its observations that the training did not cover."""
        for name, (low, high) in self.sizes.items():
            if not low <= (size := getattr(robot, name)) <= high:
                yield f"robot.{name}={size:.4g} ({low:.4g} to {high:.4g})"
        if layout.reach < (1 - TOLERANCE) * self.layout.reach:
            yield f"ground perceived up to {layout.reach:.4g} m ({self.layout.reach:.4g} m)"


class Task(Protocol):
    """What a controller is about to drive, and the policies that its settings name."""

    @property
    def config(self) -> Any:
        """Configuration of the environment; its sections are attributes, as in ``config.robot``."""

    @property
    def path(self) -> str:
        """Section of the controller's settings, ``controller`` or ``teacher.controller``."""

    def policy(self, setting: str, /) -> ValuedPolicy:
        """Return the policy that a setting of ``uses`` names; its layout fits the environment."""

    def value(self, setting: str, /) -> LearnedValue:
        """Return the values of the run, checkpoint or shipped policy that the setting names."""


class TrainingEpisodes(Protocol):
    """Episodes from which a controller learns its settings in ``flipperctl tune``."""

    rng: np.random.Generator
    """Generator for everything random, seeded by ``--seed``."""
    layout: ObservationLayout
    """Layout of all observations."""
    robot: Robot
    """The robot that drives, before anything is sampled."""

    @property
    def left(self) -> int:
        """Number of episodes that may still be played."""

    def play(self, policy: Policy, /) -> RecordedEpisode:
        """Play the next episode, on each scene in turn, and count it.

        ``tune`` maximises the sum of its ``rewards``. A reward is minus the pitch variation of the
        decision; the last one also subtracts the cost of a failure [rad]. With ``--for reward`` the
        rewards are the configured ones [-].
        """

    def demonstrations(self) -> Iterator[RecordedEpisode]:
        """Yield the episodes of ``from=``: recorded drives, or a policy's until none is left.

        Drives have the ``rewards`` with which they were recorded.
        """


class Controller(Plugin):
    """The frozen settings from which a policy is built.

    A rule without memory implements ``act``. Every other controller implements ``build``, which
    returns an object that may keep state, as a network's settings build its module. One that learns
    its settings implements ``learn``.

    Before ``build``, ``using`` and then ``paying`` are called. One that drives by files or plans on
    the configured rewards overrides them, and builds from the copy that it returned.
    """

    kind: ClassVar[str] = "controller"
    searches_first: ClassVar[bool] = False
    """Whether the policy's ``reset`` runs a search, which may take long."""
    closed_loop: ClassVar[bool] = False
    """Whether a policy that searches first also decides in states to which others led, so that it
    can teach."""
    baselines: ClassVar[tuple[str, ...]] = ()
    """Names of the controllers that ``eval`` compares this one with by default."""
    imitates: ClassVar[bool] = False
    """Whether ``learn`` needs demonstrations."""
    reference_settings: ClassVar[Mapping[str, Any]] = {}
    """Fields that differ from their defaults where the controller teaches, or is named beside
    another policy: as a baseline, a reference or one of several that are compared."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Raise TypeError for one that implements neither ``act`` nor ``build``, or ``begin``."""
        if not any(_implements(cls, name) for name in ("act", "build")):
            raise TypeError(f"controller {cls.__name__} needs a method act(p) or build()")
        if hasattr(cls, "begin"):
            raise TypeError(
                f"controller {cls.__name__}: begin is never called; write build(), which returns "
                "an object with reset and act"
            )

    def build(self) -> Policy:
        """Return a new policy with these settings; ``reset`` begins each of its episodes."""
        return Rule(self)

    def act(self, p: Perception) -> Action:
        """Return the next action, an index or rates, from this perception alone."""
        raise TypeError(f"controller {type(self).__name__} decides through build() only")

    def uses(self) -> Mapping[str, str]:
        """Return the policies and files that the settings name, by setting.

        A key is a field, or an entry of one that holds several: ``policy``, ``others[0]``. A value
        is a run, a checkpoint, an exported file, a shipped policy or any other file. Their content
        counts in the keys of stored episodes, in place of the settings.
        """
        return {}

    def using(self, task: Task) -> Self:
        """Return a copy with what ``uses`` names; raise ``ValueError`` if it cannot do the task."""
        return self

    def paying(self, rewards: Mapping[str, RewardTerm]) -> Self:
        """Return a copy that plans on the reward terms of the configuration, by their names."""
        return self

    def remarks(self, task: Task) -> Iterable[str]:
        """Return sentences on what it will do otherwise than its settings say; none by default."""
        return ()

    def learn(self, episodes: TrainingEpisodes) -> Self:
        """Return a controller with settings that were learnt; ``flipperctl tune`` calls it."""
        raise TypeError(f"controller {type(self).__name__} learns nothing")


def _implements(cls: type[Controller], method: str) -> bool:
    """Return whether the class overrides the method, which the core may have wrapped."""
    return inspect.unwrap(getattr(cls, method)) is not getattr(Controller, method)


def is_rule(controller: Controller) -> bool:
    """Return whether the controller decides by each perception alone."""
    return not _implements(type(controller), "build")


def plans_on_rewards(controller: Controller) -> bool:
    """Return whether the controller drives for the configured rewards."""
    return _implements(type(controller), "paying")


def learns(controller: Controller) -> bool:
    """Return whether the controller can learn its settings."""
    return _implements(type(controller), "learn")


class Rule:
    """The policy of a controller without memory."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; a rule remembers nothing."""

    def act(self, p: Perception) -> Action:
        """Return the controller's action."""
        return self._controller.act(p)


ControllerT = TypeVar("ControllerT", bound=Controller)


def controller(name: str) -> Callable[[type[ControllerT]], type[ControllerT]]:
    """Register a ``Controller``; ``eval <name>`` plays it."""
    return register(Controller, name)


@dataclass(frozen=True)
class StateGroups:
    """G groups of K states that lie close to each other on one ground."""

    observations: NDArray[np.float32]
    """(G, K, n) in SI units."""
    values: NDArray[np.float32]
    """Discounted return from each action on, (G, K, 9) [-]; every value is finite."""


class Network(Plugin, ABC):
    """Builds the Q-network.

    The Q-values of an observation depend on it and on the weights alone, not on earlier calls or on
    other rows, and the input is not changed. The loss is computed in ``train()`` mode: there
    layers may also draw from torch's global generator, as ``torch.nn.Dropout`` does, which is
    seeded for each update. Decisions and targets are computed in ``eval()`` mode.

    The module may have methods besides ``forward`` that change how it is trained:

    - ``quantiles(observation)`` → (B, n_actions, K): K equally likely values of each action's
      return. ``forward`` returns their mean; they are learned by quantile regression.
    - ``draw_noise(rng: np.random.Generator)`` of the module or of any submodule samples new noise
      before each decision of training and before each update. The noise acts in ``train()`` mode
      only, in which such a part also is in decisions and targets of training; a policy is
      evaluated and exported in ``eval()`` mode. Tensors of noise are non-persistent buffers.
    """

    kind: ClassVar[str] = "network"

    @property
    def frames(self) -> int:
        """Number of the newest observations in one input row, at most ``MAX_HISTORY``.

        A row contains the n numbers of each observation, the oldest observation first. At the
        start of an episode the first observation is repeated to fill the row.
        """
        return 1

    @abstractmethod
    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module from (B, frames · n) in SI units to Q-values (B, n_actions)."""


NetworkT = TypeVar("NetworkT", bound=Network)


def network(name: str) -> Callable[[type[NetworkT]], type[NetworkT]]:
    """Register a ``Network``; choose it with ``network=<name>``."""
    return register(Network, name)
