"""Budgets of decisions that are too small to learn anything.

In: a training's configuration. Out: sentences for whoever typed it.
"""

from __future__ import annotations

from collections.abc import Iterator

from flipperctl.config.models import TrainConfig


def notes_on_budget(config: TrainConfig) -> Iterator[str]:
    """Yield a line if a new training ends before its policy changes for the first time."""
    agent, teacher, decisions = config.agent, config.teacher, config.train.decisions
    if agent.draws:
        settings = agent.policy_gradient
        first = (settings.warm_up + 1) * settings.decisions
        if decisions < first:
            yield (
                f"train.decisions={decisions} leaves the policy as it begins: it learns from "
                f"{first} decisions on; {settings.warm_up} rounds of "
                f"agent.policy_gradient.decisions={settings.decisions} are for the values alone"
            )
    elif decisions < agent.learning_starts and not (teacher.episodes or teacher.final_updates):
        yield (
            f"train.decisions={decisions} leaves the policy as it begins: learning starts after "
            f"agent.learning_starts={agent.learning_starts} decisions"
        )
