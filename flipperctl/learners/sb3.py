"""Stable-Baselines3 as a learner: its settings; ``sb3_run`` alone imports the library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal, NoReturn, get_args

from pydantic import Field, JsonValue, model_validator

from flipperctl.api import Learner, Learning, Training, learner
from flipperctl.config import TrainConfig
from flipperctl.core.targets import ActionKind

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


@learner("sb3")
class Sb3(Learner):
    """Learn by Stable-Baselines3: DQN, PPO, A2C, SAC, TD3 or DDPG on perceptrons."""

    own_loop: ClassVar[bool] = True
    default_network: ClassVar[str] = "mlp"
    packages: ClassVar[tuple[str, ...]] = ("stable-baselines3",)
    resumes_exactly: ClassVar[bool] = False
    short: ClassVar[Mapping[str, Any]] = {"settings": {"learning_starts": 16, "batch_size": 8}}

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
    def _with_defaults(cls, values: Any) -> Any:
        """Add our own defaults, so that a run's configuration has them."""
        # Values of another type are pydantic's to refuse.
        if not isinstance(values, dict) or not isinstance(values.get("settings", {}), dict):
            return values
        defaults = DEFAULTS.get(str(values.get("algorithm", "dqn")), {})
        return {**values, "settings": {**defaults, **values.get("settings", {})}}

    @property
    def drives(self) -> tuple[ActionKind, ...]:
        """The kinds of actions that the algorithm takes."""
        if self.algorithm == "dqn":
            return ("turns",)
        return ("turns", "rates") if self.algorithm in ("ppo", "a2c") else ("rates",)

    @classmethod
    def arguments(cls) -> Iterator[tuple[str, Any]]:
        """Yield the arguments of each algorithm, as the library describes them."""
        from flipperctl.learners.sb3_run import arguments

        for name in get_args(Algorithm):
            for field in arguments(name, DEFAULTS[name]):
                key = f"settings.{field.name}"
                yield f"agent=sb3 agent.algorithm={name}", replace(field, name=key)

    def check(self, config: TrainConfig) -> None:
        """Refuse another network than perceptrons."""
        if (network := config.network.plugin_name) != self.default_network:
            raise ValueError(
                f"network: {network} does not go with agent=sb3, which trains perceptrons; "
                f"network={self.default_network} is allowed"
            )
        if config.actions == "turns" and config.robot.flippers != "pairs":
            raise ValueError("actions: agent=sb3 drives four flippers by rates; set actions=rates")

    def check_start(self, config: TrainConfig) -> None:
        """Refuse arguments that the algorithm does not take."""
        from flipperctl.learners.sb3_run import Request, check_settings

        check_settings(Request(self.algorithm, self.settings, self.gamma), config)

    def first_update(self, config: TrainConfig) -> tuple[int, str] | None:
        """Return the decisions before an off-policy algorithm learns."""
        # On-policy algorithms have no such argument; their rollouts count from the first decision.
        starts = self.settings.get("learning_starts", 0)
        if not isinstance(starts, int):
            return None
        return starts + 1, (
            f"learning starts after agent.settings.learning_starts={starts} decisions"
        )

    def build(self, training: Training) -> Learning:
        """Return the algorithm with its policy and replay."""
        from flipperctl.learners.sb3_run import Request, Sb3Learning

        return Sb3Learning(Request(self.algorithm, self.settings, self.gamma), training)

    def drive(self, *arguments: Any) -> NoReturn:
        """Do nothing: the algorithm drives itself."""
        raise TypeError("agent=sb3 plays its episodes itself")
