"""The search for a controller's settings: a bowl with noise, episodes of trainings, real ones."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.checkpoint import recording
from flipperctl.config import EvalConfig
from flipperctl.errors import InterruptedRunError, PluginFailedError, RequestError
from flipperctl.evaluation.learning import PlayedEpisodes, Playing
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.seeds import PRICE
from flipperctl.evaluation.tuning import Setting, Spending, search, settings_of
from flipperctl.lookahead import Mpc
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, training_seed
from tests.cli.call import call, refused

SPACE = [Setting("x", 0.0, 10.0, whole=False), Setting("n", 0.0, 4.0, whole=True)]
START = {"x": 8.0, "n": 0}
SPENDING = Spending(candidates=6, generations=25, episodes=2, final=5)


class Bowl:
    """(x - 3)² + (n - 2)², on draws that shift all candidates alike."""

    def __init__(self, stop: int | None = None) -> None:
        self.played: list[tuple[int, int, int]] = []
        self._stop = stop

    def __call__(
        self, candidates: Sequence[dict[str, float]], draws: int, episodes: int, label: str
    ) -> list[Any]:
        if draws == self._stop:
            raise InterruptedRunError("interrupted")
        self.played.append((draws, len(candidates), episodes))
        shift = np.random.default_rng(draws).uniform(0.0, 100.0, (1, episodes))
        return [{"0": (c["x"] - 3) ** 2 + (c["n"] - 2) ** 2 + shift} for c in candidates]


def test_wide_ranges_are_searched_on_a_logarithmic_scale() -> None:
    wide = Setting("swing", 1.0, 1025.0, whole=False, scale=1.0)
    # 1 + (1025^½ - 1) with 1025 = 1 + 1024 / 1
    assert wide.at(0.5) == pytest.approx(1025**0.5, rel=1e-5)
    assert wide.share(1025**0.5) == pytest.approx(0.5)
    assert [wide.at(0), wide.at(1)] == [1.0, 1025.0]
    mpc = {one.name: one for one in settings_of(Mpc(), ["swing", "beam"])}
    assert list(mpc) == ["swing", "beam"]
    assert mpc["beam"].at(mpc["beam"].share(Mpc().beam)) == Mpc().beam
    assert settings_of(Mpc(horizon=1), ["horizon"])[0].scale == 0.0  # at its bound


def find(measure: Any, **more: Any) -> Any:
    def valid(fields: dict[str, float]) -> bool:
        return fields["x"] != 10.0

    return search(SPACE, START, valid, SPENDING, measure, seed=3, **more)


def test_a_search_finds_the_minimum_and_measures_it_on_draws_of_its_own() -> None:
    found = find(bowl := Bowl())
    assert found.found["n"] == 2
    assert found.found["x"] == pytest.approx(3.0, abs=0.2)
    expected = (found.found["x"] - 3) ** 2 - (5**2 + 2**2)  # shifts cancel in pairs
    assert found.difference.mean == pytest.approx(expected)
    assert found.before.mean - found.after.mean == pytest.approx(-expected)
    generations = [(number, 6, 2) for number in range(25)]
    *searched, (choice, finalists, five), scores = bowl.played
    assert searched == generations  # each on draws of its own
    assert (choice, five) == (25, 5)
    assert 2 <= finalists <= 5
    assert scores == (26, 2, 5)


def test_luck_in_the_search_does_not_choose() -> None:
    def lucky(candidates: Sequence[Any], draws: int, episodes: int, label: str) -> list[Any]:
        if draws < SPENDING.generations:
            return [{"0": np.full((1, episodes), c["x"])} for c in candidates]
        others = np.array([[0.0, 2.5, 0.0, 1.0, 1.4]])  # 0.98 on average, the start 1.0
        return [{"0": np.ones((1, 5)) if c == START else others} for c in candidates]

    assert find(lucky).found == START


def test_an_interrupted_search_goes_on_where_it_stopped() -> None:
    kept: list[list[list[float]]] = []

    def keep(costs: list[list[float]]) -> None:
        kept.append([list(one) for one in costs])

    with pytest.raises(InterruptedRunError):
        find(Bowl(stop=4), keep=keep)
    assert len(kept[-1]) == 4
    again = Bowl()
    assert find(again, earlier=kept[-1]) == find(Bowl())
    assert again.played[0] == (4, 6, 2)


def test_a_budget_is_divided_and_is_enough_for_one_generation() -> None:
    # 4 + ⌊3 ln 3⌋ candidates; ⌊5000 / 4 / 7⌋ = 178 at the end, five times and twice;
    # (5000 - 1246) / (7 · 20) generations
    assert Spending.of(5000, 3, 1, None) == Spending(7, 26, 20, 178)
    assert Spending.of(5000, 1, 10, 3) == Spending(6, 21, 3, 17)  # (5000 - 1190) // 180
    with pytest.raises(RequestError, match=r"budget: at least 187 episodes are needed.* is 100"):
        Spending.of(100, 3, 1, None)
    assert Spending.of(187, 3, 1, None).generations == 1


OKADA = PolicySource(settings={"name": "okada"})
SHORT = ["terrain=step", "terrain.platform=0.4", "episode.run_up=0.8", "episode.run_out=0.2"]


def test_episodes_are_those_of_trainings_alone() -> None:
    config = EvalConfig(terrain={"name": "flat", "length": 0.1})
    with Player(training=True) as player:
        playing = Playing([Entry(config, OKADA)], "pitch", 5, player, lambda size: None)
        ours = playing([{"far": 0.5}, {"far": 0.6}], 2, 3, "")
        rows = [row for held in player.store._rows.values() for row in held.values()]
    assert [score["0"].shape for score in ours] == [(1, 3), (1, 3)]
    expected = {training_seed(training_seed(5, 2), episode) for episode in range(3)}
    assert {row["seed"] for row in rows} == expected
    evaluated = EvaluationSeeds.of(5, config.terrain).first(100)
    assert max(expected) < 2**32 < min(evaluated)


class Played:
    """A player of four episodes: of two candidates on one scene, two each."""

    def play_many(self, requests: Any, label: str) -> Any:
        assert [source.settings["far"] for _, source in requests] == [0.5, 0.6]
        for parts in ((("reached", 1.5), ("stuck", 0.2)), (("reached", 7.0), ("reached", 2.0))):
            yield Episodes(
                tuple(
                    {"outcome": outcome, "pitch_variation_100hz": value, "return": 10 * value}
                    for outcome, value in parts
                )
            )


def test_a_failure_costs_a_turn_as_a_rougher_crossing_does_and_a_reward_counts_as_it_is() -> None:
    entry, fields = Entry(EvalConfig(terrain={"name": "flat"}), OKADA), [{"far": 0.5}, {"far": 0.6}]

    def costs(objective: Any) -> list[list[float]]:
        player: Any = Played()
        playing = Playing([entry], objective, 0, player, lambda size: None)
        return [score["0"][0].tolist() for score in playing(fields, 0, 2, "")]

    assert costs("pitch") == [[1.5, PRICE], [PRICE, 2.0]]
    assert costs("reward") == [[-15.0, -2.0], [-70.0, -20.0]]


def test_a_rule_is_tuned_and_evaluated_by_its_file(tmp_path: Path) -> None:
    words = ["tune", "okada", *SHORT, "budget=80", "--episodes", "2", "--output", "a.yaml"]
    other = {"search": {}, "costs": []}
    (tmp_path / "a.search.json").write_text(json.dumps(other))
    assert "a.search.json is of another search" in refused(*words, cwd=tmp_path)
    (tmp_path / "a.search.json").unlink()
    done = call(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "over 5 fresh training episodes" in done.out
    assert [file.name for file in tmp_path.iterdir()] == ["a.yaml"]
    played = call("eval", "okada", "a.yaml", *SHORT, "--episodes", "2", cwd=tmp_path)
    assert played.code == 0, played.err
    assert "a.yaml" in played.out


def test_episodes_to_learn_from_pay_what_is_scored_and_are_those_of_trainings() -> None:
    slippery = EvalConfig(terrain={"name": "step"}, sim={"name": "planar", "friction": 0.1})
    whole = EvalConfig(terrain={"name": "step"})
    policy = OKADA.build(whole)
    played = PlayedEpisodes([Entry(whole, OKADA), Entry(slippery, OKADA)], "pitch", 7, 2)
    reached, failed = played.play(policy), played.play(policy)
    assert (reached.outcome, failed.outcome) == ("reached", "stuck")
    assert [reached.seed, failed.seed] == [training_seed(7, 0), training_seed(7, 1)]
    with Player(training=True) as player:
        config = whole.model_copy(update={"eval": whole.eval.model_copy(update={"seed": 7})})
        (row,) = player.play(config, OKADA, "", [0])
    assert row["seed"] == reached.seed
    assert -reached.rewards.sum() == pytest.approx(row["pitch_variation_100hz"])
    assert failed.rewards[-1] <= -PRICE < failed.rewards[0]
    with pytest.raises(PluginFailedError, match="learn played more than its 2 episodes"):
        played.play(policy)


def test_an_interrupted_learner_ends_as_such() -> None:
    entry = Entry(
        EvalConfig(terrain={"name": "step"}), PolicySource(settings={"name": "zimmermann"})
    )
    stopped = PlayedEpisodes([entry], "pitch", 0, 9, stop=lambda: True)
    with pytest.raises(InterruptedRunError):
        entry.source.controller().learn(stopped)


def test_rules_learn_and_are_evaluated_by_their_files(tmp_path: Path) -> None:
    env = EvalConfig(terrain={"name": "step"})
    driven = PlayedEpisodes([Entry(env, OKADA)], "reward", 0, 1).play(OKADA.build(env))
    (tmp_path / "me").mkdir()
    recording.write(tmp_path / "me" / "drive_step_0.safetensors", "person: me", [(env, [driven])])
    for words in (["zimmermann"], ["hfc", "from=okada"], ["hfc", "from=me"]):
        file = f"{words[-1].partition('=')[2] or 'z'}.yaml"
        few = [*SHORT, "budget=24", "--output", file]
        done = call("tune", *words, *few, cwd=tmp_path)
        assert done.code == 0, done.err
        assert "over 5 fresh training episodes" in done.out
        assert "those of the package" in done.out  # before
        assert "beyond chance" in done.out.splitlines()[-1]
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "me",
        "me.yaml",
        "okada.yaml",
        "z.yaml",
    ]
    files = ["z.yaml", "okada.yaml", "me.yaml"]
    played = call("eval", *files, *SHORT, "--episodes", "1", cwd=tmp_path)
    assert played.code == 0, played.err
    other = ["hfc", "from=me", "terrain=step", "perception.bins=9", "budget=24"]
    assert "here bins=9" in refused("tune", *other, cwd=tmp_path)
    other[3] = "robot.track_radius=0.09"
    assert "driven with robot.track_radius=0.1; here 0.09" in refused("tune", *other, cwd=tmp_path)
