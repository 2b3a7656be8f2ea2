"""The audit plays the episodes of an evaluation, for any policy."""

import pytest

from flipperctl import api
from flipperctl.api import Controller, Perception, Policy, Simulator
from flipperctl.config import EvalConfig
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.evaluation.views.audit import audit
from flipperctl.policies.source import PolicySource

PLANNER = PolicySource(settings={"name": "planner", "width": 2, "budget": 200})


@pytest.mark.parametrize("source", [PLANNER, PolicySource(settings={"name": "okada"})])
def test_the_audit_pays_what_the_evaluation_pays(source: PolicySource) -> None:
    config = EvalConfig(
        terrain="step", rewards={"pitch": "pitch", "travel": "travel"}, eval={"seed": 5}
    )
    found = audit(config, source, episodes=2)
    runner = EpisodeRunner(config, source, 5)
    results = [runner.play(0), runner.play(1)]
    assert found["decisions"] == sum(result["decisions"] for result in results)
    mean = sum(result["return"] for result in results) / 2
    assert found["return"] == pytest.approx(mean)
    for name, term in found["terms"].items():
        paid = sum(result[f"reward_{name}"] for result in results) / found["decisions"]
        assert term["mean"] == pytest.approx(paid)
        assert term["lowest"] <= term["mean"] <= term["highest"]
    assert sum(term["share"] for term in found["terms"].values()) == pytest.approx(1.0)


def test_an_audit_tells_what_never_matters_from_what_says_nothing() -> None:
    # On flat ground with level flippers the chassis does not swing; each decision of the end pays
    # 0 but the last, which pays 10.
    rewards = {"pitch": "pitch", "end": "end", "nothing": {"name": "travel", "weight": 0.0}}
    config = EvalConfig(terrain="flat", rewards=rewards)
    found = audit(config, PolicySource(settings={"name": "level"}), episodes=2)
    pitch, end, nothing = (found["terms"][name] for name in rewards)
    assert (end["lowest"], end["highest"], end["saturated"]) == (0.0, 10.0, None)
    assert end["mean"] == pytest.approx(20.0 / found["decisions"])
    assert found["return"] == pytest.approx(10.0, abs=1e-3)
    assert end["share"] == pytest.approx(1.0, abs=1e-3)
    assert pitch["saturated"] == 0.0
    assert (nothing["weight"], nothing["share"], nothing["saturated"]) == (0.0, 0.0, None)


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
    source = PolicySource(settings={"name": "searches"})
    audit(EvalConfig(terrain="flat"), source, episodes=2, report=reported.append)
    assert len(begun) == 2
    assert reported == [0.5, 1.0, 1.5, 2.0]
