"""The policies of a teacher's episodes: they label the decisions from which a student learns.

In: a student's policy, and a teacher with the student's share of the episodes; or any policy. Out:
actions, each with a label: the target distribution over actions for a student, (9,), from the cost
of each action or the action that a policy takes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    FloatArray,
    Perception,
    Policy,
    Simulator,
    StateGroups,
)
from flipperctl.config import Teacher
from flipperctl.core.risk import RiskSign
from flipperctl.errors import ConfigError
from flipperctl.policies.plugin import PluginPolicy

TEMPERATURE = 0.3
"""Default cost difference that makes an action e times less probable [s]."""


def from_costs(costs: FloatArray, temperature: float = TEMPERATURE) -> NDArray[np.float32]:
    """Return softmax(-costs / temperature), (9,).

    ``costs``: finite cost of each action, (9,) [s]; ``temperature`` in seconds.
    """
    weights = np.exp((costs.min() - costs) / temperature)
    return np.asarray(weights / weights.sum(), np.float32)


def from_action(action: int) -> NDArray[np.float32]:
    """Return the distribution that is 1 at ``action`` and 0 elsewhere, (9,)."""
    label = np.zeros(len(ACTIONS), np.float32)
    label[action] = 1.0
    return label


def none() -> NDArray[np.float32]:
    """Return the zeros of a state without a label, (9,)."""
    return np.zeros(len(ACTIONS), np.float32)


class Labeller:
    """Asks a policy for actions and labels them, by their costs if the policy offers them."""

    def __init__(self, policy: Policy, temperature: float = TEMPERATURE) -> None:
        """``temperature``: difference of costs [s]; see ``from_costs``."""
        self._policy, self._temperature = policy, temperature
        offers = isinstance(policy, PluginPolicy) and policy.offers_costs
        self._costs: Any = policy if offers else None

    def choose(self, p: Perception) -> tuple[int, NDArray[np.float32]]:
        """Return the policy's action, the cheapest if it offers costs, and the label, (9,)."""
        if self._costs is None:
            action = self._policy.act(p)
            return action, from_action(action)
        costs: FloatArray = self._costs.costs(p)
        return int(costs.argmin()), from_costs(costs, self._temperature)

    def took(self, action: int) -> None:
        """Tell a policy that offers costs which action was taken after ``choose``."""
        if self._costs is not None:
            self._costs.took(action)


class DemonstratingPolicy:
    """Acts as its policy; labels each decision by action costs, or by the action without costs."""

    def __init__(self, policy: Policy) -> None:
        self._policy: Any = policy
        self._labeller = Labeller(policy)
        self.label = from_action(0)
        """The distribution over actions at the last decision, (9,)."""
        self.groups = None
        self.risk_sign: RiskSign | None = getattr(policy, "risk_sign", None)
        """When the policy's risk is a warning; None if it knows none."""

    @property
    def risk(self) -> float | None:
        """Risk at the policy's last decision; None if it knows none."""
        return None if self.risk_sign is None else self._policy.risk

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the policy's action, the cheapest if it offers costs; store the label."""
        action, self.label = self._labeller.choose(p)
        self._labeller.took(action)
        return action


class DaggerPolicy:
    """Lets the student or the teacher act for an episode; the teacher labels both (DAgger).

    Ross, Gordon and Bagnell 2011, with whole episodes instead of single decisions mixed.
    """

    def __init__(
        self,
        student: Policy,
        teacher: PluginPolicy,
        settings: Teacher,
        student_learns: Callable[[], bool],
        rng: np.random.Generator,
    ) -> None:
        """``student_learns`` is called before each episode; while it is False, the teacher acts.

        ``rng`` chooses who acts, and the random actions of the teacher's episodes.
        """
        self._student, self._teacher, self._settings = student, teacher, settings
        self._labeller = Labeller(teacher, settings.temperature)
        if settings.label_share < 1 and not teacher.follows:
            raise ConfigError(
                f"teacher.label_share: {settings.label_share:g} needs a teacher that follows "
                "decisions which it does not label, such as mpc; 1 is allowed"
            )
        self._student_learns, self._rng = student_learns, rng
        self._student_acts = False
        self.explored = False
        """Whether the last action was random."""
        self._simulator: Simulator | None = None
        self.label = from_action(0)
        """The teacher's distribution over actions at the last decision, (9,); zeros without one."""
        self.groups: StateGroups | None = None
        """States of the episode's ground with their values, of a teacher that knows them."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode of both policies and choose which one acts."""
        self._student.reset(simulator)
        self._teacher.reset(simulator)
        if self._settings.privileged:
            simulator.restart()  # the policies may have simulated in it
            self._simulator = simulator
        if self._teacher.values_states:
            self.groups = self._teacher.state_groups(self._rng)
        share = self._settings.student_share if self._student_learns() else 0.0
        self._student_acts = self._rng.random() < share

    def act(self, p: Perception) -> int:
        """Return the acting policy's action; store the teacher's label."""
        simulator = self._simulator
        seen = p if simulator is None else simulator.perceive_exactly()
        action = self._decided(p, seen)
        if simulator is not None:
            simulator.step(action)  # repeats the episode bit for bit
        return action

    def _decided(self, p: Perception, seen: Perception) -> int:
        """Return the action taken; the teacher has ``seen`` the state, and labels or follows."""
        if self._student_acts and self._skips():
            action, self.label = self._student_action(p), none()
            self._teacher.follow(seen, action)
            return action
        choice, self.label = self._labeller.choose(seen)
        action = self._chosen(p, choice)
        self._labeller.took(action)
        return action

    def _skips(self) -> bool:
        """Return whether a decision of the student has no label."""
        share = self._settings.label_share
        return share < 1 and bool(self._rng.random() >= share)

    def _student_action(self, p: Perception) -> int:
        action = self._student.act(p)
        self.explored = getattr(self._student, "explored", False)
        return action

    def _chosen(self, p: Perception, choice: int) -> int:
        """Return the student's action, or the teacher's ``choice`` or a random one."""
        if self._student_acts:
            return self._student_action(p)
        self.explored = self._rng.random() < self._settings.random
        if self.explored:
            return int(self._rng.integers(len(ACTIONS)))
        return choice
