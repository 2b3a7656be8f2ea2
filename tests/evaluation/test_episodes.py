"""The episodes of an evaluation: known outcomes and times for any number of processes."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import Outcome
from flipperctl.config import EnvConfig, EvalConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.rows import RECORDED, Row, arranged, telling
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.rollout.episode import EvaluationSeeds, play
from flipperctl.rollout.pool import WorkerPool
from flipperctl.rollout.risks import EpisodeRisks
from tests.rollout.notes import process_ids

LEVEL = PolicySource(settings={"name": "level"})
OKADA = PolicySource(settings={"name": "okada"})


def play_episodes(
    config: EnvConfig,
    source: PolicySource,
    *,
    episodes: int,
    seed: int,
    player: Player | None = None,
    jobs: int = 1,
    record: bool = False,
) -> list[Row]:
    """Play the first episodes of an evaluation."""
    sections = {name: getattr(config, name) for name in EnvConfig.model_fields}
    chosen = EvalConfig(**sections, eval={"seed": seed, "episodes": episodes, "jobs": jobs})
    with player or Player() as playing:
        return list(playing.play(chosen, source, "", record=record))


def test_a_policy_that_stands_at_a_thin_plate_warns_before_it_is_stuck(tmp_path: Path) -> None:
    plate = tmp_path / "plate.csv"  # higher than the robot can climb with so little friction
    plate.write_text("x,z\n0,0\n0,0.4\n0.02,0.4\n0.02,0\n")
    ground = {"name": "profile_file", "path": str(plate)}
    config = EnvConfig(terrain=ground, sim={"friction": 0.3})
    (row,) = play_episodes(config, load_policy("generalist"), episodes=1, seed=5)
    risks = EpisodeRisks.pop(dict(row))
    assert row["outcome"] == Outcome.STUCK
    assert risks is not None
    assert risks.in_time
    assert not any(risks.warnings[:10])


HIGH = {"name": "step", "height": 0.4}


def test_two_processes_give_the_results_of_one() -> None:
    config = EnvConfig(terrain="step")
    one = play_episodes(config, OKADA, episodes=4, seed=3)
    two = {"episodes": 4, "seed": 3, "jobs": 2}
    with Player() as player:
        played = [player.play(EvalConfig(terrain="step", eval=two), p, "") for p in (OKADA, LEVEL)]
    assert one == list(played[0])
    assert list(played[1]) == play_episodes(config, LEVEL, episodes=4, seed=3)
    assert [result["episode"] for result in one] == [0, 1, 2, 3]
    assert [result["seed"] for result in one] == EvaluationSeeds.of(3, config.terrain).first(4)


def test_an_evaluation_survives_its_workers_and_keeps_its_numbers(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    started = []
    create = WorkerPool.__init__

    def remembered(self: WorkerPool, *arguments: object) -> None:
        create(self, *arguments)
        started.append(self)

    monkeypatch.setattr(WorkerPool, "__init__", remembered)
    config = EnvConfig(terrain="step")

    @contextmanager
    def killing(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
        def report(done: float) -> None:
            if done == 1:
                for pid in process_ids(started[0]):
                    os.kill(pid, signal.SIGKILL)

        yield report

    player = Player(progress=killing)
    found = play_episodes(config, OKADA, episodes=16, seed=3, player=player, jobs=2)
    assert found == play_episodes(config, OKADA, episodes=16, seed=3)
    assert "a worker died and is replaced; episode" in caplog.text


def test_flippers_held_level_cross_flat_ground_at_belt_speed_without_a_swing() -> None:
    for result in play_episodes(EnvConfig(terrain="flat"), LEVEL, episodes=3, seed=0):
        assert result["outcome"] == Outcome.REACHED
        # 1 m before, 2 m of flat ground and 1 m past it at 0.2 m/s, less the shift of the start;
        # an episode ends at a sample of 10 ms after that.
        assert result["t_cost"] == pytest.approx((4.0 - result["start_shift"]) / 0.2, abs=0.03)
        assert result["decisions"] == -(-round(100 * result["t_cost"]) // 60)
        for name in ("pitch_variation_decisions", "max_pitch", "flipper_travel"):
            assert result[name] == pytest.approx(0.0, abs=1e-3)
        paid = [value for name, value in result.items() if name.startswith("reward_")]
        assert result["return"] == pytest.approx(sum(paid))
        assert result["reward_end"] == 10.0


def test_an_episode_that_nothing_else_ends_ends_at_its_last_decision() -> None:
    config = EnvConfig(terrain=HIGH, episode={"stuck_window": 200, "slack": 1.2})
    (result,) = play_episodes(config, LEVEL, episodes=1, seed=0)
    assert result["outcome"] == Outcome.TIMEOUT
    # From 1 m before the edge to 1 m past it at 0.2 m/s, in decisions of 0.6 s, 1.2 times.
    assert result["decisions"] == pytest.approx(1.2 * 2.0 / 0.2 / 0.6, abs=1)
    assert result["t_cost"] == pytest.approx(0.6 * result["decisions"])


def test_what_a_search_reports_stands_in_the_result_of_the_episode() -> None:
    env = FlipperEnv("flat")
    level = resolver.create("controller", "level", "test").build()
    level.reset = lambda simulator: simulator.report_result(width=3, source="guess")
    row = play(env, level, seed=0)
    assert (row["search_width"], row["search_source"]) == (3, "guess")
    assert arranged({"episode": 0, **row}) == {"episode": 0, **row}


def test_recorded_episodes_are_those_of_the_evaluation() -> None:
    config = EnvConfig(terrain="step", episode={"run_up": 0.8, "run_out": 0.2})
    source = PolicySource(settings={"name": "mpc", "beam": 2, "horizon": 2})
    plain = play_episodes(config, source, episodes=2, seed=3)
    found = play_episodes(config, source, episodes=2, seed=3, jobs=2, record=True)
    assert [{k: v for k, v in row.items() if k != RECORDED} for row in found] == plain
    for result in found:  # a policy that offers costs drives the same when it is recorded
        recorded = result[RECORDED]
        assert (recorded.number, recorded.seed) == (result["episode"], result["seed"])
        assert (recorded.terrain, recorded.outcome) == (result["terrain"], result["outcome"])
        assert len(recorded.actions) == len(recorded.labels) == result["decisions"]
        assert recorded.observations.shape == (
            result["decisions"] + 1,
            config.perception.layout.size,
        )
        assert recorded.rewards.sum() == pytest.approx(result["return"])
        assert (recorded.labels.argmax(axis=1) == recorded.actions).all()
        assert ((recorded.labels > 0).sum(axis=1) > 1).any()  # by costs, not by the action alone
    (rule,) = play_episodes(config, OKADA, episodes=1, seed=3, record=True)
    recorded = rule[RECORDED]
    assert (recorded.labels == np.eye(9)[recorded.actions]).all()


def test_the_telling_episode_is_the_liveliest_that_most_finish() -> None:
    flat, lively, failed = (0, True, 0.1), (1, True, 0.8), (2, False, 9.0)
    assert telling([flat, lively, failed, flat, lively, (2, True, 0.2)]) == 1
    assert telling([flat, flat]) == 0
    assert telling([(1, False, 1.0), (2, False, 2.0)]) == 2
