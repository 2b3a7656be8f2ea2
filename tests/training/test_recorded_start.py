"""When the student of a training with recorded episodes drives: as soon as it learns."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl.checkpoint import recording
from flipperctl.config import EnvConfig
from flipperctl.evaluation.rows import RECORDED
from flipperctl.policies.source import PolicySource
from flipperctl.policies.teaching import DaggerPolicy
from flipperctl.rollout import actor
from flipperctl.rollout.collect import RolloutWorkers
from flipperctl.training import episodes
from tests.played import play_episodes
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("starts", [30, 1000])
def test_recorded_decisions_count_before_the_student_drives(
    starts: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = EnvConfig(terrain="step")
    rule = PolicySource(settings={"name": "okada"})
    played = play_episodes(environment, rule, episodes=2, seed=5, record=True)
    file = tmp_path / "okada.safetensors"
    recording.write(file, "okada", [(environment, [e[RECORDED] for e in played])])
    settings: dict[str, Any] = {
        "agent.learning_starts": starts,
        "teacher.controller": {"name": "okada"},
        "teacher.episodes": str(file),
    }
    recorded = sum(len(e[RECORDED].actions) for e in played)
    assert 30 < recorded < 1000
    begins = max(1, starts - recorded)

    made: list[dict[str, Any]] = []

    class Workers(RolloutWorkers):
        def __init__(self, count: int, config: dict[str, Any], plugin_paths: list[str]) -> None:
            made.append(config)
            super().__init__(count, config, plugin_paths)

    monkeypatch.setattr(episodes, "RolloutWorkers", Workers)
    fast = trainer(short_config(**settings, **{"train.mode": "fast"}), tmp_path / "fast")
    fast.run(lambda: True)
    assert [config["agent"]["learning_starts"] for config in made] == [begins]

    learns: list[Callable[[], bool]] = []

    def taught(*arguments: Any) -> DaggerPolicy:
        learns.append(arguments[3])
        return DaggerPolicy(*arguments)

    monkeypatch.setattr(actor, "DaggerPolicy", taught)
    exact = trainer(short_config(**settings), tmp_path / "exact")
    exact.run(lambda: True)
    for decision, student in ((begins - 1, False), (begins, True)):
        exact.progress.decision = decision
        assert [check() for check in learns] == [student]
