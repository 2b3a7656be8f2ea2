"""The valued states of a run: stored with the episodes that bring them, sampled for the updates."""

from __future__ import annotations

import numpy as np

from flipperctl.agent.groups import GroupBatch, GroupMemory
from flipperctl.config import Teacher
from flipperctl.errors import ConfigError
from flipperctl.rollout.values import Step


class ValuedStates:
    """Groups of states with values, if the teacher's loss learns from them."""

    def __init__(self, teacher: Teacher) -> None:
        self._teacher = teacher
        self.memory = GroupMemory(teacher.kept_groups)

    def add(self, step: Step) -> None:
        """Store what the last step of an episode brings.

        Raises:
            ConfigError: the teacher's loss needs values, and the teacher gives none.
        """
        if self._teacher.loss != "values" or step.ending is None:
            return
        if step.groups is None:
            name = getattr(self._teacher.controller, "plugin_name", None)
            raise ConfigError(
                f"teacher.loss=values: the controller {name} values no states; "
                "teacher=searched does"
            )
        self.memory.add(step.groups)

    def batches(self, count: int, rng: np.random.Generator) -> list[GroupBatch]:
        """Return a batch for each of ``count`` gradient steps; none without stored states."""
        if not len(self.memory):
            return []
        return [self.memory.sample(self._teacher.batch_groups, rng) for _ in range(count)]
