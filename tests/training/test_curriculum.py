"""A curriculum in training: difficulty grows with success, is recorded, and is resumed."""

from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.training.listeners import MetricsCsv, read_rows
from tests.short import short_config, trainer

CURRICULUM = {
    "terrain": {
        "name": "curriculum",
        "easy": {"name": "flat", "length": 0.1},
        "hard": {"name": "flat", "length": 1.1},
        "up": 0.25,
    },
    "train.decisions": 300,
    "train.validate_every": 1000,
    "train.validation_episodes": 1,
    "episode.run_up": 0.8,
    "episode.run_out": 0.0,
}


def test_difficulty_grows_with_success_and_is_kept_when_a_run_is_resumed(tmp_path: Path) -> None:
    config = short_config(**CURRICULUM)
    path, tail = tmp_path / "metrics.csv", tmp_path / "tail.csv"
    whole = trainer(config, tmp_path / "whole")
    whole.listeners.append(MetricsCsv(path, []))
    whole.run()

    rows = [row for row in read_rows(path) if row["kind"] == "episode"]
    expected = 0.0
    for row in rows:
        assert float(row["difficulty"]) == pytest.approx(expected)
        expected = config.terrain.next_difficulty(expected, row["outcome"] == "reached")
    assert float(rows[-1]["difficulty"]) > 0.5
    assert {row["terrain"] for row in rows} == {"flat"}

    first = trainer(config, tmp_path / "parts")
    first.run(stop=lambda: first.progress.difficulty >= 0.5)
    second = trainer(config, tmp_path / "parts")
    second.restore(checkpoint.read(tmp_path / "parts" / checkpoint.LAST))
    assert second.progress.difficulty == 0.5
    second.listeners.append(MetricsCsv(tail, []))
    second.run()
    rest = [row for row in read_rows(tail) if row["kind"] == "episode"]
    for ours, theirs in zip(rest, rows[first.progress.episode :], strict=True):
        for key in ("episode", "seed", "difficulty", "outcome", "return"):
            assert ours[key] == theirs[key]


def test_only_training_uses_the_easy_terrain() -> None:
    env = FlipperEnv(config=short_config(**CURRICULUM).environment())
    env.reset(seed=0, options={"difficulty": 0.5})
    assert env.profile.end == pytest.approx(0.6)
    env.reset(seed=0)
    assert env.profile.end == pytest.approx(1.1)
    with pytest.raises(ValueError, match="no difficulty 2; 0 to 1 is allowed"):
        env.reset(seed=0, options={"difficulty": 2})
    with pytest.raises(ValueError, match="difficulty 2 is not within 0 and 1"):
        env.config.terrain.at(2)
