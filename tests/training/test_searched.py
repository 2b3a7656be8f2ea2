"""Training with searched values: it runs, resumes bit for bit, and refuses what values nothing."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from flipperctl import checkpoint
from flipperctl.api import (
    Controller,
    FloatArray,
    ObservationLayout,
    Perception,
    Policy,
    Simulator,
    StateGroups,
)
from flipperctl.config import TrainConfig
from flipperctl.errors import CheckpointError, ConfigError, PluginFailedError
from flipperctl.learners.d3qn_run import DoubleQLearning
from flipperctl.lookahead.value_iteration import SIZE
from flipperctl.requests import compose
from flipperctl.requests.text import from_words
from tests.short import short_config, trainer
from tests.training.conftest import require_resumes

LENGTH = ObservationLayout().size

pytestmark = pytest.mark.slow

TINY = [
    "experiment=searched",
    "terrain=flat",
    "terrain.length=0.1",
    "episode.run_up=0.3",
    "episode.run_out=0.3",
    "teacher.controller.groups=6",
    "teacher.controller.horizon=1",
    "teacher.controller.beam=1",
    "teacher.batch_groups=4",
    "teacher.kept_groups=10",
    "network.terrain=[8]",
    "network.fused=8",
    "network.head=8",
    "agent.batch_size=8",
    "agent.learning_starts=4",
    "train.validate_every=10",
    "train.validation_episodes=1",
]
"""Episodes of six or seven decisions on 0.7 m of level ground."""


def tiny(decisions: int, mode: str = "exact") -> TrainConfig:
    """Return the configuration of the experiment ``searched`` with a small budget."""
    compose.register_defaults()
    more = [f"train.decisions={decisions}", f"train.mode={mode}", "train.workers=2"]
    (config,) = compose.compose_train(from_words([*TINY, *more]))
    return config


@pytest.mark.long
def test_the_experiment_resumes_bit_for_bit_with_its_groups(tmp_path: Path) -> None:
    config = tiny(32)
    run = trainer(config, tmp_path / "whole")
    run.run()
    require_resumes(config, tmp_path / "whole", tmp_path / "parts", 10)
    whole = checkpoint.read(tmp_path / "whole" / checkpoint.LAST)
    assert whole.document.state is not None
    assert whole.document.state.learner["groups"] >= 12  # of two whole episodes; ten are kept
    kept = whole.part("groups")
    assert kept["observations"].shape == (10, SIZE, config.perception.layout.size)
    assert kept["values"].shape == (10, SIZE, 9)
    assert float(kept["values"].std()) > 0.1
    assert isinstance(run.learning, DoubleQLearning)
    run.learning._valued.memory._arrays["values"][0, 0, 0] = np.inf
    run.save()
    damaged = checkpoint.read(tmp_path / "whole" / checkpoint.LAST)
    with pytest.raises(CheckpointError, match="part groups is not valid: a number is not finite"):
        trainer(config, tmp_path).restore(damaged)


@pytest.mark.long
def test_workers_carry_the_groups(tmp_path: Path) -> None:
    run = trainer(tiny(12, "fast"), tmp_path)
    run.run()
    assert run.valued.memory.added == 6 * run.progress.episode > 0


class _Rating:
    """Holds the flippers; values states as its settings say."""

    def __init__(self, shapes: list[tuple[int, int]]) -> None:
        self._shapes, self._episode = shapes, -1

    def reset(self, simulator: Simulator) -> None:
        self._episode += 1

    def act(self, p: Perception) -> int:
        return 4

    def costs(self, p: Perception) -> FloatArray:
        return np.abs(np.arange(9.0) - 4)

    def took(self, action: int) -> None:
        pass

    def groups(self, rng: np.random.Generator) -> StateGroups:
        states, size = self._shapes[min(self._episode, len(self._shapes) - 1)]
        seen, values = (rng.normal(size=(5, states, n)).astype(np.float32) for n in (size, 9))
        return StateGroups(seen, values)


class Rater(Controller):
    """Values states at random."""

    plugin_name: ClassVar[str] = "rater"
    shapes: list[tuple[int, int]] = [(3, LENGTH)]  # noqa: RUF012  # pydantic copies it

    def build(self) -> Policy:
        return _Rating(self.shapes)


def taught(controller: Any, **more: Any) -> TrainConfig:
    short = {
        **{"terrain": {"name": "flat", "length": 0.1}, "train.decisions": 20},
        **{"episode.run_up": 0.3, "episode.run_out": 0.3, "train.validation_episodes": 1},
        **{"agent.learning_starts": 4, "teacher.student_share": 0.0, "teacher.random": 0.0},
        **{"teacher.controller": controller, "teacher.loss": "values"},
    }
    return short_config(**{**short, **more})


def test_a_plugin_s_groups_are_learned_from(registry: dict[Any, Any], tmp_path: Path) -> None:
    registry["controller", "rater"] = Rater
    run = trainer(taught({"name": "rater"}), tmp_path)
    run.run()
    memory = run.learning._valued.memory
    assert (memory.added, memory.states) == (5 * run.progress.episode, 3)
    text = r"^teacher\.loss=values: the controller okada values no states; teacher=searched does$"
    with pytest.raises(ConfigError, match=text):
        trainer(taught({"name": "okada"}), tmp_path / "okada").run()


@pytest.mark.parametrize(
    ("shapes", "text"),
    [
        (
            [(3, 7)],
            f"returned groups of 3 observations of 7 numbers; observations of {LENGTH} numbers",
        ),
        ([(3, LENGTH), (4, LENGTH)], f"returned groups of 4 observations of {LENGTH} numbers"),
    ],
)
def test_groups_of_another_size_name_their_plugin(
    shapes: list[tuple[int, int]], text: str, registry: dict[Any, Any], tmp_path: Path
) -> None:
    registry["controller", "rater"] = Rater
    run = trainer(taught({"name": "rater", "shapes": shapes}), tmp_path)
    with pytest.raises(PluginFailedError, match=rf"'rater'.*{text}"):
        run.run()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"network": "stacked"}, r"^network: stacked takes \d+ observations; teacher\.loss=values"),
        ({"teacher.controller": None}, r"^teacher\.loss: values are computed by a controller"),
        (
            {"agent.gamma": 0.9},
            r"teacher\.controller\.gamma: 0\.99 is not agent\.gamma \(0\.9\)",
        ),
    ],
)
def test_settings_that_values_contradict_are_refused(settings: dict[str, Any], text: str) -> None:
    searched = {"teacher.controller": {"name": "value_iteration"}, "teacher.loss": "values"}
    with pytest.raises(ConfigError, match=text):
        short_config(**{**searched, **settings})
