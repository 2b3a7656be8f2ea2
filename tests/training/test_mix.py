"""A training on a mix, whose parts draw different numbers."""

from pathlib import Path

from flipperctl.training.listeners import MetricsCsv, read_rows
from tests.short import short_config, trainer

MIX = {
    "terrain": {"name": "mix", "parts": ["gap", "step"]},
    "train.decisions": 300,
    "train.validate_every": 150,
    "train.validation_episodes": 5,
}


def test_validations_and_rows_hold_what_every_episode_has(tmp_path: Path) -> None:
    learner = trainer(short_config(**MIX), tmp_path)
    learner.listeners.append(MetricsCsv(tmp_path / "metrics.csv", []))
    rows = list[dict[str, object]]()

    class Watch:
        def episode(self, row: dict[str, object]) -> None:
            rows.append(row)

        def validation(self, row: dict[str, object]) -> None:
            rows.append(row)

        def note(self, text: str) -> None: ...

        def close(self) -> None: ...

    learner.listeners.append(Watch())
    learner.run()
    written = read_rows(tmp_path / "metrics.csv")
    assert len({row["terrain"] for row in written if row["kind"] == "episode"}) > 1
    assert sum(row["kind"] == "validation" for row in written) == 2
    assert not [name for row in rows for name in row if name.startswith("drawn_")]
