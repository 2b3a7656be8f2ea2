"""The valued states of a run: stored with the episodes that bring them, sampled for the updates."""

from __future__ import annotations

import numpy as np

from flipperctl.agent.groups import GroupBatch, GroupMemory
from flipperctl.config import Teacher
from flipperctl.errors import ConfigError
from flipperctl.guard import refusal
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
            PluginFailedError: its groups have another size than observations, or than earlier ones.
        """
        if self._teacher.loss != "values" or step.ending is None:
            return
        controller = self._teacher.controller
        assert controller is not None  # the configuration was checked
        if step.groups is None:
            raise ConfigError(
                f"teacher.loss=values: the controller {controller.plugin_name} values no states; "
                "teacher=searched does"
            )
        states, numbers = step.groups.observations.shape[1:]
        if numbers != len(step.observation) or states != (self.memory.states or states):
            text = (
                f"returned groups of {states} observations of {numbers} numbers; observations of "
                f"{len(step.observation)} numbers are allowed, equally many in each group and "
                "episode"
            )
            raise refusal(controller, "groups", text)
        self.memory.add(step.groups)

    def batches(self, count: int, rng: np.random.Generator) -> list[GroupBatch]:
        """Return a batch for each of ``count`` gradient steps; none without stored states."""
        if not len(self.memory):
            return []
        return [self.memory.sample(self._teacher.batch_groups, rng) for _ in range(count)]
