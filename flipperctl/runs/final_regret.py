"""The return of a training's best policy and of simple rules, measured after its last validation.

In: a training's configuration and its run directory. Out: plain data for ``summary.json``. The
episodes have seeds of their own and use no generator of the training, so that a run that is resumed
with a larger budget is not affected.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from flipperctl import checkpoint
from flipperctl.api.controllers import is_rule
from flipperctl.config import EnvConfig, Eval, EvalConfig, TrainConfig, to_dict
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.store import EpisodeStore
from flipperctl.evaluation.views.regret import LEVEL, RegretScene, measure
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource
from flipperctl.reward_sum import paying_terms
from flipperctl.runs.inherited import TRAINED

SEED = 2_718_281_828
"""Seed of the evaluation, unlike the default one of ``eval``, so that who chooses among runs by
this measure can still evaluate the chosen one on episodes that had no part in it."""
_POLICY, _TEACHER = "best policy", "teacher"
_RULES = (LEVEL, "okada")


class FinalRegret:
    """Measures the best policy of a finished run once; stops at the next episode after Ctrl-C."""

    def __init__(
        self,
        config: TrainConfig,
        directory: Path,
        stop: Callable[[], bool],
        tell: Callable[[str], None],
    ) -> None:
        """``tell`` is called with a line if a policy or the environment fails."""
        self._config, self._directory = config, directory
        self._stop, self._tell = stop, tell
        self.interrupted = False
        """Whether the measurement was stopped; the run is finished nevertheless."""

    def __call__(self) -> dict[str, Any] | None:
        """Return the result; None if it is turned off, was stopped, or failed."""
        if not self._config.train.regret_episodes or not paying_terms(self._config.rewards):
            return None
        try:
            with EpisodeWorkers(stop=self._stop) as workers:
                found = measure(self._scene(), Player(EpisodeStore(), workers))
                self.interrupted = workers.interrupted
        except KeyboardInterrupt:  # a second Ctrl-C; the summary is still to be written
            self.interrupted = True
            return None
        except FlipperctlError as error:
            self._tell(f"the return of the best policy is not measured: {error}")
            return None
        if found is None:
            return None
        kept = {k: v for k, v in found.items() if k not in ("terrain", "rewards", "conditions")}
        return {"seed": SEED, **kept}

    def _scene(self) -> RegretScene:
        """Return the episodes in the conditions of the training, with its own reward terms."""
        config, best = self._config, self._directory / checkpoint.BEST
        sections = {name: getattr(config, name) for name in EnvConfig.model_fields}
        settings = Eval(episodes=config.train.regret_episodes, seed=SEED)
        evaluation = EvalConfig(**sections, conditions=TRAINED, eval=settings)
        return RegretScene(
            evaluation, "own", _POLICY, PolicySource(checkpoint=best), self._references()
        )

    def _references(self) -> dict[str, PolicySource]:
        """Return the rules, and the teacher if it is another rule; what searches takes too long."""
        found = {name: PolicySource.of_plugin(name, "controller") for name in _RULES}
        teacher = self._config.teacher.controller
        if teacher is not None and is_rule(teacher):
            source = PolicySource(settings=to_dict(teacher))
            if source not in found.values():
                found[_TEACHER] = source
        return found
