"""Training: it learns, chooses its best policy, and its records and listeners are complete."""

from pathlib import Path
from typing import Any, cast

import pytest

from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.checkpoint.document import Validation
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import MissingExtraError, WriteError
from flipperctl.terminal.streams import print_note
from flipperctl.text.files import read_csv
from flipperctl.training import run as training
from flipperctl.training.listeners import GuardedLogger, MetricsCsv
from flipperctl.training.trainer import Trainer
from flipperctl.training.validation import Validator
from tests.cli.call import RUN
from tests.rollout.notes import Notes
from tests.short import few, short_config, trainer

slow = pytest.mark.slow


@slow
@pytest.mark.long
def test_a_short_training_learns_to_climb_steps(tmp_path: Path) -> None:
    learner = trainer(
        short_config(**{"train.decisions": 3000, "agent.epsilon_decisions": 2000}), tmp_path
    )
    best = learner.run()["best"]
    # An untrained network hardly ever reaches the finish (first validation); a trained one mostly.
    assert best is not None
    assert best["success_rate"] >= 2 / 3
    assert best["decision"] > 300


def test_updates_wait_for_the_first_complete_transition(tmp_path: Path) -> None:
    # The first transition of 10 steps is complete after 10 decisions, of which each has an update.
    eager = {"agent.learning_starts": 1, "agent.update_every": 1, "agent.updates_together": 1}
    learner = trainer(few(**eager, **{"agent.n_step": 10, "train.decisions": 30}), tmp_path)
    summary = learner.run()
    assert learner.progress.updates == 21
    assert (summary["finished"], summary["last"]["decision"]) == (True, 30)


@slow
def test_metrics_have_a_row_per_episode_and_validation(tmp_path: Path) -> None:
    """On a mix, whose parts draw different numbers."""
    path, terms = tmp_path / "metrics.csv", ["flipper", "pitch", "end"]
    first = trainer(few(terrain={"name": "mix", "parts": ["gap", "step"]}), tmp_path)
    first.listeners += [MetricsCsv(path, terms), listener := Notes()]
    first.run()
    rows = read_csv(path)
    episodes = [row for row in rows if row["kind"] == "episode"]
    assert [int(row["episode"]) for row in episodes] == list(range(1, first.progress.episode + 1))
    parts = [sum(float(row[f"reward_{term}"]) for term in terms) for row in episodes]
    assert parts == pytest.approx([float(row["return"]) for row in episodes])
    assert len({row["terrain"] for row in episodes}) > 1
    assert sum(row["kind"] == "validation" for row in rows) == 2
    assert not [name for row in listener.rows for name in row if name.startswith("drawn_")]


@pytest.mark.parametrize(
    ("best_by", "histories", "best"),
    [
        # (decision, success, return, pitch variation at decisions, at 100 Hz)
        ("success", [(1, 0.9, 0, 0.1, 0.2), (2, 1.0, 0, 1.0, 1.5), (3, 1.0, 0, 1.2, 1.3)], 3),
        ("return", [(1, 1.0, 1.0, 1, 1), (2, 0.9, 2.0, 2, 2)], 2),
        ("last", [(300, 1.0, 0, 1, 1), (600, 0.9, 0, 2, 2)], 600),
    ],
)
def test_the_best_policy_is_chosen_as_asked(
    best_by: str, histories: list[tuple[float, ...]], best: int, tmp_path: Path
) -> None:
    validator: Validator = trainer(few(**{"train.best_by": best_by}), tmp_path).validator
    names = (
        "decision",
        "success_rate",
        "mean_return",
        "pitch_variation_decisions",
        "pitch_variation_100hz",
    )
    validator.history[:] = [
        Validation(t_cost=10.0, **dict(zip(names, one, strict=True))) for one in histories
    ]
    assert validator.best is not None
    assert validator.best.decision == best


def test_a_validation_s_return_counts_every_episode_and_no_shaping(tmp_path: Path) -> None:
    shaped = {"rewards": {"shaped_progress": {"name": "shaped_progress"}}}  # beside the paper's
    run = trainer(short_config(**{"train.validation_episodes": 4, **shaped}), tmp_path)
    rows = list[dict[str, Any]]()

    class Kept:
        def evaluate(self, weights: object, seeds: list[int], play: Any) -> list[dict[str, Any]]:
            rows.extend(play(seed) for seed in seeds)
            return rows

    found = run.validator.validate(cast(Any, Kept()), 0)
    assert found is not None
    assert {row["outcome"] for row in rows} - {"reached"}  # untrained
    paid = [row["reward_flipper"] + row["reward_pitch"] + row["reward_end"] for row in rows]
    assert found.mean_return == pytest.approx(sum(paid) / len(rows))
    assert found.mean_return != pytest.approx(sum(row["return"] for row in rows) / len(rows))


# Listeners


@pytest.fixture
def flat(tmp_path: Path) -> Trainer:
    """A training of few decisions on level ground."""
    short = {**RUN, "train.mode": "exact", "episode.run_out": 0.2}
    return trainer(with_overrides(TrainConfig(terrain="flat", network="mlp"), short), tmp_path)


@pytest.mark.parametrize("method", ["episode", "close"])
def test_all_listeners_are_closed_though_one_fails(method: str, flat: Trainer) -> None:
    listeners = [Notes(), Notes(method), Notes()]
    flat.listeners += listeners
    with pytest.raises(WriteError, match=f"{method} failed"):
        flat.run()
    assert [listener.closed for listener in listeners] == [1, 1, 1]


def no_space(*given: object) -> None:
    raise WriteError("no space")


def test_a_listener_that_cannot_be_made_closes_those_before(flat: Trainer) -> None:
    reports: Any = training.Reports([no_space])
    with pytest.raises(WriteError, match="no space"):
        training._train(flat, None, reports, lambda: False)
    metrics = flat.listeners[0]
    assert isinstance(metrics, MetricsCsv)
    assert metrics._file.closed


class Broken(Logger):
    """Opens a listener that fails."""

    plugin_name = "broken"
    listener: Any = None

    def open(self, run: RunInfo) -> Listener:
        if isinstance(self.listener, BaseException):
            raise self.listener
        return cast(Listener, self.listener)


def guarded(listener: Any, folder: Path) -> GuardedLogger:
    """Open the logger as a training does."""
    run = RunInfo(folder, folder / "broken", {}, None)
    return GuardedLogger(Broken(listener=listener), run, print_note)


@pytest.mark.parametrize("method", ["open", "validation", "note", "close"])
def test_a_logger_that_fails_is_dropped_with_one_warning(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = Notes(method)
    logger = guarded(ValueError("no disk") if method == "open" else listener, tmp_path)
    for _ in range(2):
        logger.episode({})
        logger.validation({})
        logger.note("a note")
    logger.close()
    line = " ".join(capfd.readouterr().err.split())
    assert line.count("warning:") == 1
    assert line.startswith(f"warning: logger 'broken': {method} raised ")
    assert "PluginFailedError" not in line
    assert line.endswith("the training continues without it")
    assert listener.closed == (method != "open")


def test_a_missing_package_refuses_the_training_and_an_interrupt_is_the_user_s(
    tmp_path: Path,
) -> None:
    with pytest.raises(MissingExtraError, match=r"logger=broken: install flipperctl\[broken\]"):
        guarded(ImportError("install flipperctl[broken]"), tmp_path)
    with pytest.raises(KeyboardInterrupt):
        guarded(KeyboardInterrupt(), tmp_path)
