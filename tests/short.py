"""A short training run for tests."""

from pathlib import Path

from flipperctl import checkpoint
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.training.trainer import Trainer

SHORT: dict[str, object] = {
    "train.decisions": 600,
    "train.validate_every": 300,
    "train.validation_episodes": 3,
    "agent.learning_starts": 100,
    "agent.epsilon_decisions": 400,
    "train.mode": "exact",
}


def short_config(**more: object) -> TrainConfig:
    """600 decisions on steps; a learner that is named has its own settings alone."""
    base = TrainConfig(terrain="step", network="at_d3qn", seed=7)
    return with_overrides(base, {**_of_learner(SHORT, more), **more})


def _of_learner(short: dict[str, object], more: dict[str, object]) -> dict[str, object]:
    return {k: v for k, v in short.items() if "agent" not in more or not k.startswith("agent.")}


def few(**more: object) -> TrainConfig:
    """300 decisions on steps, with two short validations."""
    less: dict[str, object] = {
        "train.decisions": 300,
        "train.validate_every": 150,
        "train.validation_episodes": 2,
        "agent.learning_starts": 50,
        "agent.epsilon_decisions": 200,
        "agent.batch_size": 32,
    }
    return short_config(**{**_of_learner(less, more), **more})


def trainer(config: TrainConfig, folder: Path) -> Trainer:
    """A trainer whose run directory is ready."""
    (folder / checkpoint.BEST.parent).mkdir(parents=True, exist_ok=True)
    return Trainer(config, folder)
