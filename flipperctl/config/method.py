"""The section ``method``: a learner of Stable-Baselines3 in place of our own."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, JsonValue

from flipperctl.api import Settings

Algorithm = Literal["dqn", "ppo", "a2c", "sac", "td3", "ddpg"]


class Sb3(Settings):
    """A learner of Stable-Baselines3; everything but the learner is as in any training."""

    name: Literal["sb3"] = "sb3"
    algorithm: Algorithm = Field(
        "dqn",
        description="dqn chooses among turns; sac, td3 and ddpg need actions=rates; ppo and a2c "
        "take both [-]",
    )
    settings: dict[str, JsonValue] = Field(
        default_factory=dict,
        description="arguments of the algorithm's class, such as learning_rate; "
        "docs/own_method.md lists those that differ from the library's defaults unasked [-]",
    )

    @property
    def example(self) -> str:
        """An override of an argument."""
        return "'method.settings={learning_rate: 0.001}'"

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of actions that the algorithm takes."""
        if self.algorithm == "dqn":
            return ("turns",)
        return ("turns", "rates") if self.algorithm in ("ppo", "a2c") else ("rates",)
