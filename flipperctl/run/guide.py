"""A rule that drives some episodes of training, so that the learner sees what the rule does."""

from __future__ import annotations

import numpy as np

from flipperctl import plugins
from flipperctl.api import Controller
from flipperctl.config import Train
from flipperctl.env.flipper_env import FlipperEnv


class Guide:
    """Decides at the start of each episode who drives it."""

    def __init__(self, settings: Train) -> None:
        self._share = settings.guided
        self._rule: Controller | None = None
        if settings.guide is not None:
            self._rule = plugins.create("controller", settings.guide, "train.guide")

    def driver(self, env: FlipperEnv, rng: np.random.Generator) -> Controller | None:
        """The rule, ready for the episode that ``env`` begins; None if the policy drives."""
        if self._rule is None or rng.random() >= self._share:
            return None
        self._rule.begin(env.simulator())
        return self._rule
