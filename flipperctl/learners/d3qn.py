"""The double dueling DQN: what goes with it, and who drives its episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from flipperctl.api import Learning, Policy, Shaping, Training, learner
from flipperctl.config import Teacher, TrainConfig
from flipperctl.learners.settings import D3qnSettings

if TYPE_CHECKING:
    import torch


@learner("d3qn")
class D3qn(D3qnSettings):
    """Learn Q-values by temporal differences (double dueling DQN), and a teacher's labels."""

    def check(self, config: TrainConfig) -> None:
        """Refuse a teacher, rewards or a network that do not go with the settings."""
        # A recording holds observations and labels, but nothing of the simulator's state.
        teacher = config.teacher
        if teacher.episodes is not None and self.privileged(config):
            raise ValueError(
                "agent.privileged_value: the recorded episodes of teacher.episodes hold no "
                "privileged states; set agent.privileged_value=false"
            )
        if teacher.loss == "values":
            self._check_values(config, teacher)
        # A potential ends at 0 with the episode; a value after the end would undo it.
        for name, term in config.rewards.items():
            if isinstance(term, Shaping) and self.bootstrap_outcomes:
                raise ValueError(
                    f"agent.bootstrap_outcomes: the shaping rewards.{name} ends with the episode, "
                    "so the value must end too; set agent.bootstrap_outcomes=[] or drop the term "
                    f"with ~rewards.{name}"
                )

    def _check_values(self, config: TrainConfig, teacher: Teacher) -> None:
        if config.robot.flippers != "pairs":
            raise ValueError(
                "robot.flippers: a search has values of pairs alone; set teacher.loss=cross_entropy"
            )
        if config.network.frames > 1:
            raise ValueError(
                f"network: {config.network.plugin_name} takes {config.network.frames} "
                "observations; teacher.loss=values teaches the values of single ones"
            )
        if teacher.controller is None:
            raise ValueError(
                "teacher.loss: values are computed by a controller, such as teacher=searched; "
                "recorded episodes have none"
            )
        if (gamma := getattr(teacher.controller, "gamma", self.gamma)) != self.gamma:
            raise ValueError(
                f"teacher.controller.gamma: {gamma} is not agent.gamma ({self.gamma}); "
                f"set teacher.controller.gamma={self.gamma}"
            )

    def check_start(self, config: TrainConfig) -> None:
        """Refuse a network, recorded episodes or weights that cannot be used."""
        from flipperctl.learners.double_q import check_memory
        from flipperctl.learners.recorded import read_teacher
        from flipperctl.learners.starting import read_start

        recording = read_teacher(config)
        decisions = config.train.decisions + (0 if recording is None else recording.decisions)
        check_memory(self, config, decisions)
        read_start(config)

    def first_update(self, config: TrainConfig) -> tuple[int, str] | None:
        """Return the decisions before the first update; None if recorded ones come before them."""
        if config.teacher.episodes or config.teacher.final_updates:
            return None
        starts = self.learning_starts
        return starts, f"learning starts after agent.learning_starts={starts} decisions"

    def build(self, training: Training) -> Learning:
        """Return networks, replay and what a teacher brings."""
        from flipperctl.learners.d3qn_run import DoubleQLearning

        return DoubleQLearning(self, training)

    def drive(
        self,
        training: Training,
        module: torch.nn.Module,
        decision: Callable[[], int],
        rng: np.random.Generator,
    ) -> Policy:
        """Return the ε-greedy policy, mixed with the teacher if one acts."""
        from flipperctl.policies.acting import ExploringPolicy
        from flipperctl.policies.controllers import DaggerPolicy
        from flipperctl.policies.source import controller_policy

        # ε follows the decisions of the whole run; in a worker one generator draws ε and noise.
        student = ExploringPolicy(
            module,
            training.network.frames,
            lambda: self.epsilon(decision()),
            rng,
            training.generators.get("noise", rng),
            share=self.exploring_share,
            joints=len(training.layout.joints),
        )
        # Without a teacher that acts, the student drives alone.
        teacher = training.config.teacher
        if teacher.controller is None:
            return student
        environment = training.config.environment()
        acting = controller_policy(teacher.controller, environment, "teacher.controller")
        # Recorded decisions count among those before the student drives.
        starts = max(1, self.learning_starts - training.shared.get("recorded", 0))
        return DaggerPolicy(student, acting, teacher, lambda: decision() >= starts, rng)
