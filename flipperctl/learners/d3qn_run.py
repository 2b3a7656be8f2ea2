"""What the double DQN has in a run: networks, replay, values of a teacher, the fit at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch

from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import GroupBatch, GroupMemory, Replay
from flipperctl.api import Step, Training
from flipperctl.config import Teacher, TrainConfig
from flipperctl.env.privileged import SIZE
from flipperctl.errors import ConfigError
from flipperctl.learners.double_q import DoubleQ, check_memory
from flipperctl.learners.final_fit import FinalFit
from flipperctl.learners.pair import PairLearning
from flipperctl.learners.recorded import add_recorded
from flipperctl.learners.settings import D3qnSettings
from flipperctl.learners.starting import load_start
from flipperctl.plugging.guard import refusal
from flipperctl.policies.source import controller_notes


class ValueTargets:
    """Groups of states with values, if the teacher's loss learns from them."""

    def __init__(self, teacher: Teacher) -> None:
        self._teacher = teacher
        self.memory = GroupMemory(teacher.kept_groups)

    def add(self, step: Step) -> None:
        """Store what the last step of an episode brings."""
        controller = self._teacher.controller
        # Groups belong to a whole episode, and come with its last step.
        if self._teacher.loss != "values" or step.ending is None or controller is None:
            return
        if step.groups is None:
            raise ConfigError(
                f"teacher.loss=values: the controller {controller.plugin_name} values no states; "
                "teacher=searched does"
            )
        # The memory stacks all groups in one array: their shapes must be equal.
        states, numbers = step.groups.observations.shape[1:]
        if numbers != len(step.observation) or states != (self.memory.states or states):
            raise refusal(
                controller,
                "groups",
                f"returned groups of {states} observations of {numbers} numbers; observations of "
                f"{len(step.observation)} numbers are allowed, equally many in each group and "
                "episode",
            )
        self.memory.add(step.groups)

    def batches(self, count: int, rng: np.random.Generator) -> list[GroupBatch]:
        """Return a batch for each of ``count`` gradient steps; none without stored states."""
        if not len(self.memory):
            return []
        return [self.memory.sample(self._teacher.batch_groups, rng) for _ in range(count)]


class DoubleQLearning(PairLearning):
    """Learns from random transitions every few decisions, and from what a teacher brings."""

    agent: DoubleQ

    def __init__(self, settings: D3qnSettings, training: Training) -> None:
        config: TrainConfig = training.config
        teacher, privileged = config.teacher, SIZE if settings.privileged(config) else 0
        # Refuse what does not fit into memory before anything is allocated.
        check_memory(settings, config, config.train.decisions)
        agent = DoubleQ(
            training.network,
            training.layout,
            settings,
            seed=training.seed,
            device=training.device,
            teacher=teacher if teacher.teaches else None,
            privileged=privileged,
        )
        # Labels and privileged states take columns only where something learns from them.
        replay = Replay(
            settings.replay_size,
            input_size(training.network, training.layout),
            settings.n_step,
            settings.gamma,
            labels=agent.actions if teacher.teaches else 0,
            actions=agent.actions,
            privileged=privileged,
            risk_horizon=settings.risk_horizon if settings.risk else 0,
            newest=training.layout.size,
            cut_at_random=settings.cut_at_random,
            prioritised=settings.priority > 0 and not teacher.teaches,
        )
        super().__init__(training, agent, replay, settings.bootstrap_outcomes)
        self._settings, self._valued = settings, ValueTargets(teacher)
        self._final_fit = FinalFit(settings, training, replay)
        # Say before the run which values of the teacher do not fit it, or who drove.
        if teacher.controller is not None:
            for note in controller_notes(teacher.controller, config, "teacher.controller"):
                training.report(note)

    def begin(self) -> None:
        """Take the weights that the training starts with, and the recorded episodes."""
        self._final_fit.begin(load_start(self.training.config, self.agent))
        add_recorded(self.replay, self.training.config, self.training.report)
        self._share_recorded()

    def _share_recorded(self) -> None:
        """Pass the workers the number of decisions before the student's first."""
        self.training.shared["recorded"] = self.replay.kept

    def add(self, step: Step, decision: int) -> None:
        """Store a decision, and update from random transitions every few.

        No update is due before the first transition, complete after ``n_step`` decisions.
        """
        super().add(step, decision)
        self._valued.add(step)
        # Several updates fall due at once, so that one forward pass computes the targets of all.
        settings, together = self._settings, self._settings.updates_together
        due = decision % (settings.update_every * together) == 0
        # Recorded decisions fill the replay already, and count as driven.
        begun = decision + self.replay.kept >= settings.learning_starts
        if due and begun and len(self.replay):
            fraction, valued = decision / self.training.decisions, self._valued.batches
            self.loss = self.agent.update_from(self.replay, self._sample_rng, fraction, valued)
            self.updates += together

    def finish(self, stop: Callable[[], bool]) -> bool:
        """Learn all labels anew, if that is configured."""
        return self._final_fit.run(self.agent, stop)

    def exploration(self, decision: int) -> float:
        """Return ε."""
        return self._settings.epsilon(decision)

    def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
        """Return networks, optimisers, replay, valued states and the weights of the start."""
        groups = self._valued.memory.tensors()
        stored = {"groups": groups} if groups else {}
        return {**super().tensors(), **self._final_fit.tensors(), **stored}

    def counters(self) -> dict[str, Any]:
        """Return the numbers of transitions and of groups."""
        return {**super().counters(), "groups": self._valued.memory.added}

    def restore(
        self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
    ) -> None:
        """Restore all that was saved."""
        super().restore(tensors, counters)
        self._share_recorded()
        # The memory compares the groups with the number that was added.
        groups, size = tensors.get("groups", {}), self.replay.arrays["observation"].shape[1]
        try:
            self._valued.memory.restore_tensors(groups, counters["groups"], size)
        except ValueError as error:
            raise ValueError(f"its part groups is not valid: {error}") from error
        self._final_fit.restore(tensors)
