"""The composed configuration as frozen pydantic models.

``sections`` and ``teacher`` define the settings, ``sampled`` the ranges sampled for each episode,
and ``models`` whole configurations; ``resolver`` builds them from names and overrides, and
``identity`` compares plugins.
"""

from flipperctl.config.identity import identity
from flipperctl.config.merge import with_overrides
from flipperctl.config.models import (
    DEFAULT_ENGINE,
    DEFAULT_LEARNER,
    PAPER_REWARDS,
    EnvConfig,
    EvalConfig,
    TrainConfig,
    default_engine,
)
from flipperctl.config.resolver import parse, to_dict
from flipperctl.config.sampled import Randomise
from flipperctl.config.sections import (
    Episode,
    Eval,
    LocalCollector,
    RayCollector,
    Train,
)
from flipperctl.config.teacher import Teacher

__all__ = [
    "DEFAULT_ENGINE",
    "DEFAULT_LEARNER",
    "PAPER_REWARDS",
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
    "default_engine",
    "identity",
    "parse",
    "to_dict",
    "with_overrides",
]
