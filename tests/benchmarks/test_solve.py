"""Time to solve."""

import pytest

from benchmarks import solve
from benchmarks.solve_run import SolveRun, Validation, ValidationRecorder
from flipperctl.training.trainer import Trainer
from tests.benchmarks.small import small_benchmark


class Clock:
    """The clock of a run that a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr("benchmarks.solve_run.time.perf_counter", lambda: self.now)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def solve_run(**changes: object) -> SolveRun:
    return SolveRun(1, small_benchmark(limit=60.0, in_a_row=3, **changes).settings)


def test_solved_is_three_perfect_validations_in_a_row(clock: Clock) -> None:
    run = solve_run()
    for index, rate in enumerate((1.0, 1.0, 0.99, 1.0, 1.0)):
        clock.now += 4.0
        run.add_validation(1000 * (index + 1), rate, took=1.0)
        assert not run.finished
    clock.now += 4.0
    run.add_validation(6000, 1.0, took=1.0)
    assert run.finished
    report = run.report()
    assert (report["seconds"], report["training_seconds"], report["decisions"]) == (
        24.0,
        18.0,
        6000,
    )


def test_out_of_time_is_not_solved(clock: Clock) -> None:
    run = solve_run()
    run.add_validation(1000, 1.0, took=1.0)
    run.add_validation(2000, 1.0, took=1.0)
    clock.now += 61.0
    run.add_validation(3000, 1.0, took=1.0)  # too late to count
    assert run.finished
    report = run.report()
    assert report["solved"] is False
    assert report["seconds"] is None
    assert len(report["validations"]) == 2


def test_the_time_since_the_episode_is_the_validations(clock: Clock) -> None:
    run = solve_run()
    listener = ValidationRecorder(run)
    clock.now += 10.0
    listener.episode({})
    clock.now += 3.0
    listener.validation({"decision": 1000, "success_rate": 0.5})
    assert run.validation_seconds == 3.0


def test_medians_count_the_unsolved_as_longest() -> None:
    def run(seconds: float | None) -> dict:
        return {
            **{"seconds": seconds, "training_seconds": seconds, "decisions": seconds},
            "solved": seconds is not None,
        }

    s = small_benchmark(seeds=3, limit=50.0).settings
    found = solve.summary(
        {"flipperctl": [run(10.0), run(20.0), run(30.0)], "sb3": [run(40.0), run(None), run(None)]},
        s,
    )
    assert found["solved"] == {"flipperctl": "3 of 3", "sb3": "1 of 3"}
    assert found["quantities"]["flipperctl.seconds"]["median"] == 20.0
    assert found["quantities"]["sb3.seconds"]["median"] is None
    assert found["ratios"]["sb3 / flipperctl, seconds"]["ratio"] is None
    assert found["ratios"]["sb3 / flipperctl, seconds"]["low"] is None  # pairs 4, ∞, ∞


def test_sb3_is_validated_on_the_trainers_episodes(tmp_path) -> None:
    config = solve.configured(small_benchmark(), 5)
    trainer = Trainer(config, tmp_path)
    (tmp_path / "checkpoints").mkdir()
    trainer.run()
    last = trainer.validator.last
    assert last is not None
    assert last.decision == trainer.progress.decision  # so the policy is the validated one
    expected = last.success_rate
    assert Validation(config)(trainer.agent.policy) == expected
