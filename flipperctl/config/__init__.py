"""The composed configuration as frozen pydantic models.

``sections`` and ``agent`` define the settings, ``sampled`` the ranges sampled for each episode, and
``models`` whole configurations; ``resolver`` builds them from names and overrides, and ``identity``
compares plugins.
"""

from flipperctl.config.agent import Agent, PolicyGradient, Teacher
from flipperctl.config.identity import identity
from flipperctl.config.models import (
    DEFAULT_ENGINE,
    PAPER_REWARDS,
    EnvConfig,
    EvalConfig,
    TrainConfig,
)
from flipperctl.config.resolver import parse, to_dict, with_overrides
from flipperctl.config.sampled import Randomise
from flipperctl.config.sections import (
    Episode,
    Eval,
    LocalCollector,
    RayCollector,
    Train,
)

__all__ = [
    "DEFAULT_ENGINE",
    "PAPER_REWARDS",
    "Agent",
    "EnvConfig",
    "Episode",
    "Eval",
    "EvalConfig",
    "LocalCollector",
    "PolicyGradient",
    "Randomise",
    "RayCollector",
    "Teacher",
    "Train",
    "TrainConfig",
    "identity",
    "parse",
    "to_dict",
    "with_overrides",
]
