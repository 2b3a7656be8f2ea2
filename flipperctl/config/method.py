"""The section ``method``: a learner of Stable-Baselines3 in place of our own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, JsonValue, model_validator

from flipperctl.api import Settings

Algorithm = Literal["dqn", "ppo", "a2c", "sac", "td3", "ddpg"]


DEFAULTS: Mapping[str, Mapping[str, JsonValue]] = {
    "dqn": {
        "learning_rate": [1e-3, 2e-5],
        "batch_size": 128,
        "buffer_size": 100_000,
        "learning_starts": 1000,
        "train_freq": 2,
        "tau": 0.01,
        "target_update_interval": 1,
        "n_steps": 3,
        "exploration_fraction": 0.3,
        "exploration_final_eps": 0.05,
    },
    "ppo": {"n_steps": 1024, "batch_size": 128, "ent_coef": 0.01},
    "a2c": {},
    "sac": {"buffer_size": 100_000, "learning_starts": 1000, "train_freq": 2, "batch_size": 128},
    "td3": {"buffer_size": 100_000, "learning_starts": 1000, "train_freq": 2, "action_noise": 0.2},
    "ddpg": {"buffer_size": 100_000, "learning_starts": 1000, "train_freq": 2, "action_noise": 0.2},
}
"""Arguments that differ from the defaults of Stable-Baselines3.

A list of two learning rates falls linearly from the first to the second. ``action_noise`` is the
standard deviation of normal noise, in rates.
"""


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
        description="arguments of the algorithm's class, such as learning_rate; those that are "
        "not given are the library's defaults, but for the ones in docs/own_method.md [-]",
    )

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, given: Any) -> Any:
        """Add our own defaults, so that a run's configuration has them."""
        if not isinstance(given, dict) or not isinstance(given.get("settings", {}), dict):
            return given
        own = DEFAULTS.get(str(given.get("algorithm", "dqn")), {})
        return {**given, "settings": {**own, **given.get("settings", {})}}

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
