"""``greedy``: the policies of files that always take the action with the largest Q-value.

In: files with Q-values. Out: actions, and the negated Q-values as costs, by which they can teach
another policy, such as a smaller network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field, PrivateAttr

from flipperctl.api import (
    Controller,
    FloatArray,
    Perception,
    Policy,
    Simulator,
    Task,
    ValuedPolicy,
    controller,
)
from flipperctl.core.targets import Action, of_rule
from flipperctl.errors import ConfigError


@controller("greedy")
class Greedy(Controller):
    """Drive by the best Q-value of policies' files, also while their risk warns.

    The values of several policies are averaged, which cancels errors of their trainings; they
    should be of one scale, as with several training seeds. The costs of the actions are the negated
    Q-values, so that it can teach. Set ``teacher.temperature`` to the ``teacher.q_temperature`` of
    their own training, or to the temperature of a policy gradient. The labels are then the
    probabilities that a policy learnt.
    """

    policy: str = Field(
        "generalist",
        description="a run, a checkpoint, an exported file or a shipped policy that drives [-]",
    )
    others: tuple[str, ...] = Field(
        (),
        description="further policies; the mean of the Q-values of all drives [-]",
    )

    _trained: tuple[ValuedPolicy, ...] = PrivateAttr(())

    def uses(self) -> Mapping[str, str]:
        """Return the settings that name policies, and their values."""
        others = {f"others[{number}]": name for number, name in enumerate(self.others)}
        return {"policy": self.policy, **others} if self.policy else others

    def using(self, task: Task) -> Greedy:
        """Return these settings with the policies that ``uses`` names, in its order."""
        settings = self.model_copy()
        settings._trained = tuple(map(task.policy, self.uses()))
        for (setting, name), policy in zip(self.uses().items(), settings._trained, strict=True):
            if policy.kind == "rates":
                raise ConfigError(f"{setting}: {name} has rates; a policy of Q-values is allowed")
        return settings

    def build(self) -> Policy:
        """Return a policy that acts by the Q-values."""
        if not self.policy or not self._trained:
            raise ConfigError(
                f"policy: {self.policy!r} is no policy of a file that this command reads; the name "
                "of a run, a checkpoint, an exported file or a shipped policy is allowed"
            )
        return GreedyPolicy(self._trained)


class GreedyPolicy:
    """Acts by the mean Q-values of other policies."""

    def __init__(self, valued: Sequence[ValuedPolicy]) -> None:
        """Act by the Q-values of ``valued``, one policy or more."""
        self._valued = valued

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""

    def act(self, p: Perception) -> Action:
        """Return the index of the action with the largest Q-value, or the rates of its turns."""
        return of_rule(int(self.costs(p).argmin()), len(p.layout.joints))

    def costs(self, p: Perception) -> FloatArray:
        """Return the negated Q-values, (3^J,) [-]."""
        total = sum(np.asarray(policy.q_values(p), np.float64) for policy in self._valued)
        return np.asarray(total / -len(self._valued), np.float64)

    def took(self, action: int) -> None:
        """Do nothing: the next costs do not depend on it."""

    def follow(self, p: Perception, action: int) -> None:
        """Do nothing: the next costs do not depend on it."""
