"""Evaluation: the numbers do not depend on the number of processes; statistics by hand."""

import os
import signal
from pathlib import Path

import pytest

from flipperctl import checkpoint, plugins
from flipperctl.config import EnvConfig
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.episodes import evaluate
from flipperctl.evaluation.statistics import differences, interval, paired, scene_summary
from flipperctl.policies.trained import ControllerSource
from flipperctl.rollout.pool import WorkerPool
from flipperctl.rollout.seeds import episode_seed

OKADA = ControllerSource(settings={"name": "okada"})


def test_two_processes_give_the_rows_of_one() -> None:
    config = EnvConfig(terrain="step")
    one = list(evaluate(config, OKADA, episodes=4, seed=3))
    two = list(evaluate(config, OKADA, episodes=4, seed=3, jobs=2))
    assert one == two
    assert [row["episode"] for row in one] == [0, 1, 2, 3]
    assert len({row["seed"] for row in one}) == 4


def test_an_evaluation_survives_its_workers_and_keeps_its_numbers(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    crews = []
    create = WorkerPool.__init__

    def remembered(self: WorkerPool, *arguments: object) -> None:
        create(self, *arguments)
        crews.append(self)

    monkeypatch.setattr(WorkerPool, "__init__", remembered)
    config = EnvConfig(terrain="stair")
    rows = evaluate(config, OKADA, episodes=30, seed=3, jobs=2)
    first = next(rows)
    for pid in crews[0].process_ids():
        os.kill(pid, signal.SIGKILL)
    assert [first, *rows] == list(evaluate(config, OKADA, episodes=30, seed=3))
    assert "a worker died and is replaced; episode" in caplog.text


def test_a_policy_is_judged_on_another_terrain(short_run: Path) -> None:
    source = ControllerSource(checkpoint=short_run / checkpoint.BEST)
    rows = list(evaluate(EnvConfig(terrain="flat"), source, episodes=1, seed=0))
    assert rows[0]["outcome"] in ("reached", "stuck", "timeout", "overturned")


def test_a_policy_refuses_another_observation_layout(short_run: Path) -> None:
    source = ControllerSource(checkpoint=short_run / checkpoint.BEST)
    config = EnvConfig(terrain="flat", perception={"bins": 11})
    with pytest.raises(CheckpointError, match=r"15 bins of 0\.15 m.*ask for 11"):
        list(evaluate(config, source, episodes=1, seed=0))


def test_the_streams_of_seeds_never_meet() -> None:
    streams = ("training", "validation", "evaluation")
    seeds = [episode_seed(s, seed, i) for s in streams for seed in (0, 1) for i in range(500)]
    assert len(set(seeds)) == len(seeds)


def row(seed: int, outcome: str, variation: float, terrain: str = "step") -> dict[str, object]:
    measures = dict.fromkeys(("t_cost", "flipper_travel", "max_pitch", "return"), 1.0)
    both = {"pitch_variation": variation, "pitch_variation_100hz": variation}
    return {"seed": seed, "terrain": terrain, "outcome": outcome, **measures, **both}


def test_interval_of_equal_values_is_a_point_and_of_none_is_none() -> None:
    assert interval([2.0, 2.0, 2.0]) == {"mean": 2.0, "low": 2.0, "high": 2.0}
    assert interval([]) is None


def test_interval_covers_the_mean_as_the_normal_approximation_says() -> None:
    # 50 zeros and 50 ones: the mean's standard error is 0.5 / √100 = 0.05, so ± 1.96 · 0.05.
    found = interval([0.0] * 50 + [1.0] * 50)
    assert found is not None
    assert found["low"] == pytest.approx(0.402, abs=0.011)
    assert found["high"] == pytest.approx(0.598, abs=0.011)


def test_scene_summary_counts_outcomes_and_averages_what_reached_the_finish() -> None:
    rows = [row(0, "reached", 1.0), row(1, "reached", 3.0), row(2, "stuck", 99.0)]
    scene = scene_summary("step", rows)
    assert scene["success_rate"] == pytest.approx(2 / 3)
    assert scene["outcomes"] == {"reached": 2, "overturned": 0, "stuck": 1, "timeout": 0}
    assert scene["pitch_variation"]["mean"] == 2.0
    assert scene["pitch_variation"]["range"] == 2.0
    nobody = scene_summary("step", [row(0, "stuck", 1.0)])
    assert nobody["t_cost"] is None


def test_scene_summary_takes_a_mix_apart() -> None:
    rows = [
        row(0, "reached", 1.0, "gap"),
        row(1, "reached", 3.0, "gap"),
        row(2, "stuck", 9.0, "wave"),
    ]
    scene = scene_summary("mix", rows)
    assert scene["success_rate"] == pytest.approx(2 / 3)
    assert list(scene["parts"]) == ["gap", "wave"]
    gap, wave = scene["parts"].values()
    assert (gap["episodes"], gap["success_rate"]) == (2, 1.0)
    assert gap["pitch_variation"]["mean"] == pytest.approx(2.0)
    assert (wave["episodes"], wave["success_rate"]) == (1, 0.0)
    assert "parts" not in scene_summary("gap", rows[:2])


def test_paired_compares_equal_draws_where_both_reached_the_finish() -> None:
    mine = [row(0, "reached", 1.0), row(1, "reached", 2.0), row(2, "stuck", 9.0)]
    theirs = [row(0, "reached", 1.5), row(1, "stuck", 0.0), row(2, "reached", 1.0)]
    found = paired(mine, theirs, "pitch_variation")
    assert found is not None
    assert (found["mean"], found["episodes"]) == (-0.5, 1)


def test_every_controller_has_a_source() -> None:
    for name in plugins.names("controller"):
        little = {"budget": 50} if name == "planner" else {}
        source = ControllerSource(settings={"name": name, **little})
        assert source.label() == name
        rows = list(evaluate(EnvConfig(terrain="flat"), source, episodes=1, seed=0))
        assert len(rows) == 1


def test_a_mix_is_compared_part_by_part_on_equal_draws() -> None:
    labels = ("gap", "gap", "wave")
    ours, theirs = (
        [row(i, "reached", v, t) for i, (v, t) in enumerate(zip(values, labels, strict=True))]
        for values in ((1.0, 2.0, 3.0), (2.0, 3.0, 9.0))
    )
    found = differences(ours, theirs)
    assert found["pitch_variation"]["mean"] == pytest.approx((-1 - 1 - 6) / 3)
    gap, wave = (found["parts"][label]["pitch_variation"] for label in ("gap", "wave"))
    assert (gap["mean"], gap["episodes"]) == (-1.0, 2)
    assert (wave["mean"], wave["episodes"]) == (-6.0, 1)
    assert "parts" not in differences(ours[:2], theirs[:2])
