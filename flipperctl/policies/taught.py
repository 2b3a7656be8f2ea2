"""The policy of training episodes with a teacher, which labels visited states.

In: a student's policy, a teacher, and the student's share of the episodes. Out: actions, each with
a label.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flipperctl.api import ACTIONS, Perception, Policy, Simulator, StateGroups
from flipperctl.config import Teacher
from flipperctl.errors import ConfigError
from flipperctl.policies import labels
from flipperctl.policies.abilities import FollowingPolicy, TrainingPolicy, ValuingPolicy


class TaughtPolicy:
    """Lets the student or the teacher act for an episode; the teacher labels both (DAgger).

    Ross, Gordon and Bagnell 2011, with whole episodes instead of single decisions mixed.
    """

    def __init__(
        self,
        student: Policy,
        teacher: Policy,
        settings: Teacher,
        student_learns: Callable[[], bool],
        rng: np.random.Generator,
    ) -> None:
        """``student_learns`` is called before each episode; while it is False, the teacher acts.

        ``rng`` chooses who acts, and the random actions of the teacher's episodes.
        """
        self._student, self._teacher, self._settings = student, teacher, settings
        self._exploring = student if isinstance(student, TrainingPolicy) else None
        self._labeller = labels.Labeller(teacher, settings.temperature)
        self._following = teacher if isinstance(teacher, FollowingPolicy) else None
        if settings.label_share < 1 and self._following is None:
            raise ConfigError(
                f"teacher.label_share: {settings.label_share:g} needs a teacher that follows "
                "decisions which it does not label, such as mpc; 1 is allowed"
            )
        self._student_learns, self._rng = student_learns, rng
        self._student_acts = False
        self.explored = False
        """Whether the last action was random."""
        self._simulator: Simulator | None = None
        self.label = labels.from_action(0)
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
        if isinstance(self._teacher, ValuingPolicy):
            self.groups = self._teacher.groups(self._rng)
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
            assert self._following is not None  # else every decision is labelled
            action, self.label = self._student_action(p), labels.none()
            self._following.follow(seen, action)
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
        self.explored = self._exploring is not None and self._exploring.explored
        return action

    def _chosen(self, p: Perception, choice: int) -> int:
        """Return the student's action, or the teacher's ``choice`` or a random one."""
        if self._student_acts:
            return self._student_action(p)
        self.explored = self._rng.random() < self._settings.random
        if self.explored:
            return int(self._rng.integers(len(ACTIONS)))
        return choice
