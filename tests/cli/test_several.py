"""``eval`` of several policies: one table, the same episodes, and only what is not there yet."""

import csv
import hashlib
import json
from collections import Counter
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.api import Policy
from flipperctl.cli.methods import method_scenes
from flipperctl.config import EnvConfig
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.runner import EpisodeRunner
from flipperctl.policies.source import PolicySource
from flipperctl.runs.methods import Entrant
from tests.cli.call import Done, call

FLAT = ("terrain=flat", "terrain.length=0.2", "--episodes", "3", "--json")


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """The number of episodes that each policy plays."""
    found: Counter[str] = Counter()
    play, build = EpisodeRunner.play, PolicySource.build
    newest: list[str] = []

    def noted(self: PolicySource, config: EnvConfig) -> Policy:
        newest.append(self.label())
        return build(self, config)

    def counted(self: EpisodeRunner, index: int) -> EpisodeResult:
        found[newest[-1]] += 1
        return play(self, index)

    monkeypatch.setattr(PolicySource, "build", noted)
    monkeypatch.setattr(EpisodeRunner, "play", counted)
    return found


CLIMBER = """
from flipperctl.api import Controller, Perception, controller

@controller("climber")
class Climber(Controller):
    \"\"\"Raises both pairs.\"\"\"

    def act(self, p: Perception) -> int:
        return 8
"""


def methods(done: Done) -> list[str]:
    assert done.code == 0, done.err
    return [scene["method"] for scene in json.loads(done.out)["scenes"]]


def test_a_further_controller_is_the_only_one_that_plays(
    tmp_path: Path, played: Counter[str]
) -> None:
    done = call("eval", "--controller", "random,okada", *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(done) == ["random", "okada", "level"]
    assert played == {"random": 3, "okada": 3, "level": 3}
    one = json.loads(done.out)["scenes"][1]
    alone = json.loads(call("eval", "--controller", "okada", *FLAT, cwd=tmp_path).out)["scenes"][0]
    assert {key: one[key] for key in alone} == alone
    with (tmp_path / "out" / "episodes.csv").open(newline="") as file:
        seeds = [row["seed"] for row in csv.DictReader(file)]
    assert seeds[:3] == seeds[3:6] == seeds[6:]

    played.clear()
    (tmp_path / "climber.py").write_text(CLIMBER)
    more = ("eval", "--controller", "okada,climber", "--plugins", "climber.py", *FLAT)
    done = call(*more, "--output", "out", cwd=tmp_path)
    assert methods(done) == ["okada", "climber", "level"]
    assert played == {"climber": 3}
    played.clear()
    done = call(*more, "--baseline", "none", "--output", "out", cwd=tmp_path)
    assert methods(done) == ["okada", "climber"]
    assert not played


def test_the_best_stored_policy_is_ranked_on_the_episodes_of_each_scene(tmp_path: Path) -> None:
    """Scenes of a suite may differ in the number of their episodes alone."""
    ground = "terrain=step terrain.low=0.4 terrain.high=0.4"
    suite = tmp_path / "mine.yaml"
    suite.write_text(f"scenes: {{few: {ground} eval.episodes=1, more: {ground} eval.episodes=2}}\n")
    to = ("--output", "out")
    done = call(
        "eval", "--controller", "okada", *ground.split(), *to, "--episodes", "2", cwd=tmp_path
    )
    assert done.code == 0, done.err
    suited = ("eval", "suite=mine.yaml", "--controller", "random", "--baseline", "level")
    done = call(*suited, *to, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = json.loads(done.out)["scenes"]
    best = [row["episodes"] for row in rows if "best known" in row.get("method", "")]
    assert best == [1, 2]
    table = csv.DictReader((tmp_path / "out" / "table.csv").read_text().splitlines())
    assert "best known (okada)" in {row["method"] for row in table}


def test_the_best_stored_policy_stands_below_the_rows_of_its_seed(tmp_path: Path) -> None:
    words = ("terrain=stair", "eval.seed=0,1", "eval.episodes=2", "--output", "out")
    assert call("eval", "--controller", "level", *words, cwd=tmp_path).code == 0
    rivals = ("eval", "--controller", "random,okada", "--baseline", "random")
    done = call(*rivals, *words, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = [(row["seed"], row.get("method", "")) for row in json.loads(done.out)["scenes"]]
    assert [seed for seed, _ in rows] == sorted(seed for seed, _ in rows)
    assert [seed for seed, method in rows if method == "best known (level)"] == [0, 1]


def test_the_best_stored_policy_stands_beside_the_others(tmp_path: Path) -> None:
    step = ("terrain=step", "terrain.low=0.4", "terrain.high=0.4", "--episodes", "2")
    suite = tmp_path / "mine.yaml"
    suite.write_text(f"scenes: {{one: '{' '.join(step[:3])}'}}\n")
    to = ("--output", "out")
    done = call("eval", "--controller", "okada", *step, *to, cwd=tmp_path)
    assert done.code == 0, done.err
    suited = ("eval", "suite=mine.yaml", "--controller", "random", "--baseline", "level")
    done = call(*suited, *step[3:], *to, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "suite mine: random" in done.out
    assert "best known (okada)" in done.out
    rows = csv.DictReader((tmp_path / "out" / "episodes.csv").read_text().splitlines())
    # Its name is not that of an okada of other settings that plays here.
    assert {row["controller"] for row in rows} == {"random", "level", "best known (okada)"}


def test_a_checkpoint_that_fails_within_a_suite_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = PolicySource.build

    def failing(self: PolicySource, config: EnvConfig) -> Policy:
        if self.label() == "random":
            raise CheckpointError("random: gone")
        return build(self, config)

    monkeypatch.setattr(PolicySource, "build", failing)
    files = ("--controller", "random,okada")
    done = call("eval", *files, *FLAT, "--output", "out", cwd=tmp_path)
    assert done.code == CheckpointError.exit_code
    error = "error: random failed on flat: random: gone; all other results are complete"
    assert done.err.splitlines()[-1] == error
    document = json.loads(done.out)
    assert [scene["method"] for scene in document["scenes"]] == ["okada", "level"]
    assert document["failed"] == [
        {"controller": "random", "terrain": "flat", "error": "random: gone"}
    ]
    monkeypatch.setattr(PolicySource, "build", build)
    again = call("eval", *files, *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(again) == ["random", "okada", "level"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--controller", "okada,"], "--controller: names between commas"),
        (["--controller", "okada,levle"], "did you mean 'level'?"),
        (["--controller", "okada,level", "--baseline", ",x"], "--baseline: names between commas"),
        (["--controller", "okada,level", "--record", "e.safetensors"], "--record takes one policy"),
        (
            ["--controller", "level", "--record", "e.safetensors", "eval.ray=auto"],
            "eval.ray: no meaning beside --record",
        ),
        (["--controller", "okada,level", "--film", "e.gif"], "--film takes one policy"),
        (["--controller", "okada", "suite=familes"], "did you mean 'families'?"),
        (["suite=families"], "give either --checkpoint"),
    ],
)
def test_a_wrong_request_is_one_line(tmp_path: Path, words: list[str], expected: str) -> None:
    done = call("eval", *words, *([] if "suite" in words[-1] else ["terrain=flat"]), cwd=tmp_path)
    assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1), done.err
    assert expected in done.err
    assert list(tmp_path.iterdir()) == []


def test_a_list_of_rewards_is_played_with_each_by_all(tmp_path: Path) -> None:
    words = ("--controller", "okada,random", "terrain=flat", "rewards=paper,smooth")
    done = call("eval", *words, "--episodes=1", "--baseline", "level", "--json", cwd=tmp_path)
    assert methods(done) == ["okada", "okada", "random", "random", "level", "level"]
    returns = [scene["return"]["mean"] for scene in json.loads(done.out)["scenes"]]
    assert all(paper != smooth for paper, smooth in zip(returns[::2], returns[1::2], strict=True))
    assert "do not compare" not in done.err


def test_other_rewards_of_a_checkpoint_are_told(tmp_path: Path) -> None:
    words = ("--checkpoint", "generalist", "--controller", "level", "terrain=flat")
    done = call("eval", *words, "--episodes", "1", "--baseline", "none", "--json", cwd=tmp_path)
    assert methods(done) == ["generalist", "level"]
    assert "return: these policies have different rewards" in done.err
    done = call("eval", *words, "--episodes", "1", "rewards=smooth", "--json", cwd=tmp_path)
    assert "different rewards" not in done.err
    words = ("--controller", "okada,random", "terrain=flat", "+reward@rewards.hit=impact")
    done = call("eval", *words, "--episodes", "1", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "different rewards" not in done.err  # the standing ones have the term too


def test_a_later_controller_tells_what_it_leaves_out_too(tmp_path: Path) -> None:
    words = ("--controller", "level,mpc", "terrain=flat", "robot.chassis_length=0.9")
    short = ("--episodes", "1", "--baseline", "none")
    done = call("eval", *words, *short, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "mpc_value was not trained for robot.chassis_length=0.9" in done.err


def test_forced_settings_of_controllers_are_those_of_all() -> None:
    entrants = [Entrant("mpc"), Entrant("value_iteration")]
    made = method_scenes(["terrain=flat", "++controller.horizon=3"], entrants, [], None)
    assert [(s.settings or {})["horizon"] for _, s in made.scenes] == [3, 3]


def test_a_controller_that_is_named_twice_plays_once(tmp_path: Path) -> None:
    words = ("--controller", "okada,okada", "terrain=flat", "--episodes", "1", "--json")
    done = call("eval", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert [scene["controller"] for scene in json.loads(done.out)["scenes"]] == ["okada"]


def test_tables_by_what_was_drawn_say_whose_they_are(tmp_path: Path) -> None:
    words = ("--controller", "okada,random", "terrain=step", "--by", "height", "--episodes", "1")
    done = call("eval", *words, "--baseline", "none", cwd=tmp_path)
    assert done.code == 0, done.err
    for name in ("okada", "random"):
        assert f"{name} on step by height" in done.out


def test_tables_of_another_evaluation_are_not_replaced_without_a_word(tmp_path: Path) -> None:
    words = ("eval", "--controller", "level,random", "--baseline", "none", "--output", "out")
    for more, told in (
        (("terrain=flat",), ""),
        (("terrain=flat,ramp",), ""),  # what was there is still in the tables
        (
            ("terrain=flat", "--seed", "3"),
            "level on flat, seed 0, 1 episodes and 3 more rows; those episodes",
        ),
        (("terrain=flat", "--seed", "3"), ""),
        (("terrain=flat", "--seed", "3", "--episodes", "2"), ""),
        (("terrain=flat", "--seed", "3"), "level on flat, seed 3, 2 episodes and 1 more rows"),
    ):
        count = () if "--episodes" in more else ("--episodes", "1")
        done = call(*words, *more, *count, cwd=tmp_path)
        assert done.code == 0, done.err
        assert told in done.err
        assert ("they replace earlier tables" in done.err) == bool(told)


def test_the_best_known_policy_is_told_from_a_later_one_of_its_name(tmp_path: Path) -> None:
    shipped = checkpoint.shipped_policies()
    words = ("eval", "--checkpoint", "mine.safetensors", "terrain=step", "--episodes", "1")
    words = (*words, "--controller", "okada", "--baseline", "level", "--output", "out", "--json")
    for name in ("mpc_value", "generalist"):  # the second one rocks more on the first step
        (tmp_path / "mine.safetensors").write_bytes(shipped[name].read_bytes())
        done = call(*words, cwd=tmp_path)
        assert done.code == 0, done.err
    digest = hashlib.sha256(shipped["mpc_value"].read_bytes()).hexdigest()
    names = [row["controller"] for row in json.loads(done.out)["scenes"]]
    assert [*names[:1], names[-1]] == ["mine.safetensors", f"mine.safetensors, {digest[:8]}"]


def test_an_evaluation_without_an_earlier_baseline_says_so(tmp_path: Path) -> None:
    words = ("eval", "--controller", "okada", "terrain=flat", "--episodes", "1", "--output", "out")
    for baseline, told in (("level", False), ("none", True), ("none", False)):
        done = call(*words, "--baseline", baseline, cwd=tmp_path)
        assert done.code == 0, done.err
        assert ("earlier tables with level on flat, seed 0, 1 episodes" in done.err) is told


def test_policies_that_bring_their_own_ground_are_told(tmp_path: Path) -> None:
    words = ("eval", "--checkpoint", "generalist", "--controller", "level", "--episodes", "1")
    done = call(*words, "--baseline", "none", "--output", "out", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "these policies play different scenes, so they do not compare (generalist: " in done.err
    assert "level: stair " in done.err
    again = call("inspect", "results", "out", cwd=tmp_path)
    assert again.code == 2
    assert "the same terrain=… and conditions=… for all are allowed" in again.err
    done = call(*words, "--baseline", "none", "terrain=flat", cwd=tmp_path)
    assert "different scenes" not in done.err
