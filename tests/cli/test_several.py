"""``eval`` of several policies: one table, the same episodes, and only what is not there yet."""

import csv
import hashlib
import json
from collections import Counter
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.api import Policy
from flipperctl.cli.plan import make_plan
from flipperctl.config import EnvConfig
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.plan import Plan
from flipperctl.evaluation.policies import entrants
from flipperctl.evaluation.rows import Row
from flipperctl.evaluation.workers import EpisodeRunner
from flipperctl.policies.source import PolicySource
from tests.cli.call import Done, call, refused

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

    def counted(self: EpisodeRunner, index: int) -> Row:
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
    done = call("eval", "random,okada", *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(done) == ["random", "okada", "level"]
    assert played == {"random": 3, "okada": 3, "level": 3}
    one = json.loads(done.out)["scenes"][1]
    alone = json.loads(call("eval", "okada", *FLAT, cwd=tmp_path).out)["scenes"][0]
    assert {key: one[key] for key in alone} == alone
    with (tmp_path / "out" / "episodes.csv").open(newline="") as file:
        seeds = [row["seed"] for row in csv.DictReader(file)]
    assert seeds[:3] == seeds[3:6] == seeds[6:]

    played.clear()
    (tmp_path / "climber.py").write_text(CLIMBER)
    more = ("eval", "okada", "climber", "--plugins", "climber.py", *FLAT)
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
    stored = ("eval", "okada", *ground.split(), "--episodes", "2", "--output", "out")
    assert call(*stored, cwd=tmp_path).code == 0
    suited = ("eval", "suite=mine.yaml", "random", "--baseline", "level", "--output", "out")
    done = call(*suited, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = json.loads(done.out)["scenes"]
    best = [row["episodes"] for row in rows if "best known" in row.get("method", "")]
    assert best == [1, 2]
    for name, key in (("table.csv", "method"), ("episodes.csv", "controller")):
        table = csv.DictReader((tmp_path / "out" / name).read_text().splitlines())
        # Its name is not that of an okada of other settings that plays here.
        assert {row[key] for row in table} == {"random", "level", "best known (okada)"}
    done = call(*suited, cwd=tmp_path)
    assert done.out.startswith("suite mine: random")
    assert "best known (okada)" in done.out


def test_the_best_stored_policy_stands_below_the_rows_of_its_seed(tmp_path: Path) -> None:
    words = ("terrain=stair", "eval.seed=0,1", "eval.episodes=2", "--output", "out")
    assert call("eval", "level", *words, cwd=tmp_path).code == 0
    rivals = ("eval", "random,okada", "--baseline", "random")
    done = call(*rivals, *words, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = [(row["seed"], row.get("method", "")) for row in json.loads(done.out)["scenes"]]
    assert [seed for seed, _ in rows] == sorted(seed for seed, _ in rows)
    assert [seed for seed, method in rows if method == "best known (level)"] == [0, 1]


def test_a_checkpoint_that_fails_within_a_suite_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = PolicySource.build

    def failing(self: PolicySource, config: EnvConfig) -> Policy:
        if self.label() == "random":
            raise CheckpointError("random: gone")
        return build(self, config)

    monkeypatch.setattr(PolicySource, "build", failing)
    done = call("eval", "random,okada", *FLAT, "--output", "out", cwd=tmp_path)
    assert done.code == CheckpointError.exit_code
    error = "error: random failed on flat: random: gone; all other results are complete"
    assert done.err.splitlines()[-1] == error
    document = json.loads(done.out)
    assert [scene["method"] for scene in document["scenes"]] == ["okada", "level"]
    assert document["failed"] == [
        {"controller": "random", "terrain": "flat", "error": "random: gone"}
    ]
    monkeypatch.setattr(PolicySource, "build", build)
    again = call("eval", "random,okada", *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(again) == ["random", "okada", "level"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--controller", "okada,"], "names between commas are allowed"),
        (["okada,levle"], "did you mean 'level'?"),
        (["okada,level", "--baseline", ",x"], "--baseline: names between commas"),
        (["okada,level", "--record", "e.safetensors"], "--record takes one policy"),
        (
            ["level", "--record", "e.safetensors", "eval.ray=auto"],
            "eval.ray: no meaning beside --record",
        ),
        (["okada", "level", "--film", "e.gif"], "--film takes one policy"),
        (["okada", "suite=familes"], "did you mean 'families'?"),
        (["suite=families"], "name a policy, as in: flipperctl eval generalist"),
    ],
)
def test_a_wrong_request_is_one_line(tmp_path: Path, words: list[str], expected: str) -> None:
    ground = [] if "suite" in words[-1] else ["terrain=flat"]
    error = refused("eval", *words, *ground, cwd=tmp_path)
    assert expected in error
    assert error.count("\n") == 1


def test_a_list_of_rewards_is_played_with_each_by_all(tmp_path: Path) -> None:
    words = ("okada,random", "terrain=flat", "rewards=paper,smooth", "--baseline", "level")
    done = call("eval", *words, "--episodes=1", "--json", cwd=tmp_path)
    assert methods(done) == ["okada", "okada", "random", "random", "level", "level"]
    returns = [scene["return"]["mean"] for scene in json.loads(done.out)["scenes"]]
    assert all(paper != smooth for paper, smooth in zip(returns[::2], returns[1::2], strict=True))
    assert "do not compare" not in done.err


def planned(names: str, *words: str, baseline: str | None = "none") -> tuple[Plan, str]:
    """Return the plan of several policies, and what is told."""
    told: list[str] = []
    plan = make_plan(list(words), entrants([names], told.append), baseline, told.append)
    return plan, "\n".join(told)


def test_other_rewards_of_a_checkpoint_are_told() -> None:
    words = ("generalist,level", "terrain=flat")
    assert "return: these policies have different rewards" in planned(*words)[1]
    assert "different rewards" not in planned(*words, "rewards=smooth")[1]
    # The standing ones have the term too.
    words = ("okada,random", "terrain=flat", "+reward@rewards.hit=impact")
    assert "different rewards" not in planned(*words, baseline=None)[1]


def test_policies_that_bring_their_own_ground_are_told() -> None:
    _, told = planned("generalist,level")
    assert "these policies play different scenes, so they do not compare (generalist: " in told
    assert "level: stair " in told
    assert "different scenes" not in planned("generalist,level", "terrain=flat")[1]


def test_a_later_controller_tells_what_it_leaves_out_too() -> None:
    _, told = planned("level,mpc", "terrain=flat", "robot.chassis_length=0.9")
    assert "mpc_value was not trained for robot.chassis_length=0.9" in told


def test_forced_settings_of_controllers_are_those_of_all() -> None:
    plan, _ = planned("mpc,value_iteration", "terrain=flat", "++controller.horizon=3")
    assert [(entry.source.settings or {})["horizon"] for entry in plan.entries] == [3, 3]


def test_a_policy_that_is_named_twice_plays_once() -> None:
    plan, _ = planned("okada,okada", "terrain=flat")
    assert [entry.label for entry in plan.entries] == ["okada"]


def test_tables_by_what_was_drawn_say_whose_they_are(tmp_path: Path) -> None:
    words = ("okada,random", "terrain=step", "--by", "height", "--episodes", "1")
    done = call("eval", *words, "--baseline", "none", cwd=tmp_path)
    assert done.code == 0, done.err
    for name in ("okada", "random"):
        assert f"{name} on step by height" in done.out


def test_tables_of_another_evaluation_are_not_replaced_without_a_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flipperctl.evaluation.pictures.draw_scenes", lambda *given: None)

    def told(*more: str, baseline: str = "none") -> str:
        count = () if "--episodes" in more else ("--episodes", "1")
        words = ("eval", "okada", *more, *count, "--baseline", baseline, "--output", "out")
        done = call(*words, "--json", cwd=tmp_path)
        assert done.code == 0, done.err
        found = [line for line in done.err.splitlines() if line.startswith("earlier tables with ")]
        return "".join(found)

    flat = "terrain=flat"
    assert told(flat) == ""
    assert told("terrain=flat,ramp") == ""  # what was there still is
    assert told(flat, "--seed", "3") == (
        "earlier tables with okada on flat, seed 0, 1 episodes and 1 more rows are replaced; those "
        "episodes stay in out/cells, and their command writes the tables again"
    )
    assert told(flat, "--seed", "3", "--episodes", "2") == ""
    assert "okada on flat, seed 3, 2 episodes are replaced" in told(flat, "--seed", "3")
    assert told(flat, "--seed", "3", baseline="level") == ""
    assert "level on flat, seed 3, 1 episodes" in told(flat, "--seed", "3")
    assert told(flat, "--seed", "3") == ""


def test_the_best_known_policy_is_told_from_a_later_one_of_its_name(tmp_path: Path) -> None:
    shipped = checkpoint.shipped_policies()
    words = ("eval", "mine.safetensors", "okada", "terrain=step", "--episodes", "1")
    words = (*words, "--baseline", "level", "--output", "out", "--json")
    for name in ("mpc_value", "generalist"):  # the second one rocks more on the first step
        (tmp_path / "mine.safetensors").write_bytes(shipped[name].read_bytes())
        done = call(*words, cwd=tmp_path)
        assert done.code == 0, done.err
    digest = hashlib.sha256(shipped["mpc_value"].read_bytes()).hexdigest()
    names = [row["controller"] for row in json.loads(done.out)["scenes"]]
    assert [*names[:1], names[-1]] == ["mine.safetensors", f"mine.safetensors, {digest[:8]}"]
