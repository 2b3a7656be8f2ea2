"""The composed configuration as frozen pydantic models.

``sections`` holds the settings, ``randomise`` the ranges sampled for each episode, ``models``
whole configurations; ``resolver`` builds them from names and overrides, and ``identity`` says which
plugins are the same.
"""

from flipperctl.config.identity import identity
from flipperctl.config.models import (
    DEFAULT_ENGINE,
    PAPER_REWARDS,
    EnvConfig,
    EvalConfig,
    TrainConfig,
)
from flipperctl.config.randomise import Randomise
from flipperctl.config.resolver import container, parse, with_overrides
from flipperctl.config.sections import (
    Agent,
    Episode,
    Eval,
    LocalCollector,
    RayCollector,
    Train,
)
from flipperctl.config.teacher import Teacher

__all__ = [
    "DEFAULT_ENGINE",
    "PAPER_REWARDS",
    "Agent",
    "EnvConfig",
    "Episode",
    "Eval",
    "EvalConfig",
    "LocalCollector",
    "Randomise",
    "RayCollector",
    "Teacher",
    "Train",
    "TrainConfig",
    "container",
    "identity",
    "parse",
    "with_overrides",
]
