"""The audit plays the episodes of an evaluation, whoever plays them."""

import numpy as np
import pytest

from flipperctl import api
from flipperctl.api import Controller, Perception, Policy, Simulator
from flipperctl.config import EnvConfig
from flipperctl.evaluation.audit import audit
from flipperctl.evaluation.episodes import evaluate
from flipperctl.policies.trained import ControllerSource

PLANNER = ControllerSource(settings={"name": "planner", "width": 2, "budget": 200})


@pytest.mark.parametrize("source", [PLANNER, ControllerSource(settings={"name": "okada"})])
def test_the_audit_pays_what_the_evaluation_pays(source: ControllerSource) -> None:
    config = EnvConfig(terrain="step", rewards={"pitch": "pitch", "travel": "travel"})
    found = audit(config, source, episodes=2, seed=5)
    rows = list(evaluate(config, source, episodes=2, seed=5))
    assert found["decisions"] == sum(row["decisions"] for row in rows)
    assert found["return"] == pytest.approx(np.mean([row["return"] for row in rows]))
    paid = sum(row["reward_travel"] for row in rows) / found["decisions"]
    assert found["terms"]["travel"]["mean"] == pytest.approx(paid)


@pytest.mark.usefixtures("registry")
def test_every_episode_is_begun_and_a_search_moves_the_progress() -> None:
    begun: list[float] = []

    @api.controller("searches")
    class Searches(Controller):
        def build(self) -> Policy:
            return Found()

    class Found:
        def reset(self, simulator: Simulator) -> None:
            begun.append(simulator.finish)
            simulator.report_progress(0.5)
            self._action = 4

        def act(self, p: Perception) -> int:
            return self._action

    reported: list[float] = []
    source = ControllerSource(settings={"name": "searches"})
    audit(EnvConfig(terrain="flat"), source, episodes=2, seed=0, report=reported.append)
    assert len(begun) == 2
    assert reported == [0.5, 1.0, 1.5, 2.0]
