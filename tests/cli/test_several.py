"""``eval`` of several policies and of sweeps: one table, equal episodes, what is missing alone."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.api import Policy
from flipperctl.config import EnvConfig
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.plan import Plan, _swept, entrants
from flipperctl.policies.source import PolicySource
from flipperctl.requests.plan import make_plan
from flipperctl.requests.text import from_words
from tests.cli.call import Done, call

FLAT = ("terrain=flat", "terrain.length=0.2", "--episodes", "3", "--json")


def methods(done: Done) -> list[str]:
    assert done.code == 0, done.err
    return [scene["method"] for scene in json.loads(done.out)["scenes"]]


def test_a_further_controller_is_the_only_one_that_plays(tmp_path: Path, played: list[int]) -> None:
    done = call("eval", "random,geometric", *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(done) == ["random", "geometric", "level"]
    assert played == [0, 1, 2] * 3
    one = json.loads(done.out)["scenes"][1]
    alone = json.loads(call("eval", "geometric", *FLAT, cwd=tmp_path).out)["scenes"][0]
    assert {key: one[key] for key in alone} == alone
    with (tmp_path / "out" / "episodes.csv").open(newline="") as file:
        seeds = [row["seed"] for row in csv.DictReader(file)]
    assert seeds[:3] == seeds[3:6] == seeds[6:]

    played.clear()
    more = ("eval", "geometric", "ohno", *FLAT)
    done = call(*more, "--output", "out", cwd=tmp_path)
    assert methods(done) == ["geometric", "ohno", "level"]
    assert played == [0, 1, 2]
    played.clear()
    done = call(*more, "--baseline", "none", "--output", "out", cwd=tmp_path)
    assert methods(done) == ["geometric", "ohno"]
    assert not played


def test_the_best_stored_policy_is_ranked_on_the_episodes_of_each_scene(tmp_path: Path) -> None:
    """Scenes of a suite may differ in the number of their episodes alone."""
    ground = "terrain=step terrain.height=0.4"
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


def test_a_checkpoint_that_fails_within_a_suite_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = PolicySource.build

    def failing(self: PolicySource, config: EnvConfig) -> Policy:
        if self.label() == "random":
            raise CheckpointError("random: gone")
        return build(self, config)

    monkeypatch.setattr(PolicySource, "build", failing)
    done = call("eval", "random,geometric", *FLAT, "--output", "out", cwd=tmp_path)
    assert done.code == CheckpointError.exit_code
    error = "error: random failed on flat: random: gone; all other results are complete"
    assert done.err.splitlines()[-1] == error
    document = json.loads(done.out)
    assert [scene["method"] for scene in document["scenes"]] == ["geometric", "level"]
    assert document["failed"] == [
        {"controller": "random", "terrain": "flat", "error": "random: gone"}
    ]
    monkeypatch.setattr(PolicySource, "build", build)
    again = call("eval", "random,geometric", *FLAT, "--output", "out", cwd=tmp_path)
    assert methods(again) == ["random", "geometric", "level"]


def test_a_list_of_rewards_is_played_with_each_by_all(tmp_path: Path) -> None:
    words = ("okada,random", "terrain=flat", "rewards=paper,smooth", "--baseline", "level")
    done = call("eval", *words, "--episodes=1", "--json", cwd=tmp_path)
    assert methods(done) == ["okada", "okada", "random", "random", "level", "level"]
    returns = [scene["return"]["mean"] for scene in json.loads(done.out)["scenes"]]
    assert all(paper != smooth for paper, smooth in zip(returns[::2], returns[1::2], strict=True))
    assert "do not compare" not in done.err


def planned(
    names: str, *words: str, baseline: str | None = "none", returns: bool = True
) -> tuple[Plan, str]:
    """Return the plan of several policies, and what is told."""
    told: list[str] = []
    policies = entrants([names], told.append)
    plan = make_plan(from_words(list(words)), policies, baseline, told.append, returns=returns)
    return plan, "\n".join(told)


def test_other_rewards_of_a_checkpoint_are_told() -> None:
    words = ("generalist,level", "terrain=flat")
    assert "return does not compare: the policies have different rewards" in planned(*words)[1]
    assert "different rewards" not in planned(*words, "rewards=smooth")[1]
    assert "different rewards" not in planned(*words, returns=False)[1]
    # The standing ones have the term too.
    words = ("okada,random", "terrain=flat", "+reward@rewards.hit=impact")
    assert "different rewards" not in planned(*words, baseline=None)[1]


def test_policies_that_bring_their_own_ground_are_told() -> None:
    _, told = planned("generalist,mpc_value,level")
    assert "these policies play different scenes, so they do not compare (generalist: " in told
    assert "level: stair " in told
    assert "different scenes" not in planned("generalist,mpc_value,level", "terrain=flat")[1]


def test_a_rule_plays_the_ground_of_the_policy_beside_it() -> None:
    plan, told = planned("level,generalist")
    assert [entry.label for entry in plan.entries] == ["level", "generalist"]
    assert len({entry.ground for entry in plan.entries}) == 1
    assert "do not compare" not in told


def test_tables_of_another_evaluation_are_not_replaced_without_a_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flipperctl.requests.traces.Traces.record", lambda *given: None)

    def told(*more: str) -> str:
        count = () if "--episodes" in more else ("--episodes", "1")
        words = ("eval", "okada", *more, *count, "--baseline", "none", "--output", "out")
        done = call(*words, "--json", cwd=tmp_path)
        assert done.code == 0, done.err
        found = [line for line in done.err.splitlines() if line.startswith("earlier tables with ")]
        return "".join(found)

    flat = "terrain=flat"
    assert told("terrain=flat,ramp") == ""
    assert told(flat, "--seed", "3") == (
        "earlier tables with okada on flat, seed 0, 1 episode and 1 more row are replaced; those "
        "episodes stay in out/cells, and their command writes the tables again"
    )
    assert told(flat, "--seed", "3", "--episodes", "2") == ""  # what was there still is
    assert "okada on flat, seed 3, 2 episodes are replaced" in told(flat, "--seed", "3")


SHIPPED = checkpoint.read(checkpoint.shipped_policies()["generalist"])


def trained(
    run: Path, seed: int, agent: Mapping[str, Any] = {}, train: Mapping[str, Any] = {}
) -> None:
    """Write the best policy of a run with other settings than those of the shipped one."""
    config = SHIPPED.document.config
    changed = {"seed": seed, "agent": {**config.agent, **agent}, "train": {**config.train, **train}}
    document = SHIPPED.document.model_copy(update={"config": config.model_copy(update=changed)})
    file = run / checkpoint.BEST
    file.parent.mkdir(parents=True)
    checkpoint.write(file, document, SHIPPED.tensors)


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path("sweep")


def test_the_folder_of_a_sweep_is_one_method_with_its_seeds(sweep: Path) -> None:
    for number, (seed, planned) in enumerate(((4, 900), (9, 1000))):  # of 900 made
        run = sweep / f"{number}_seed={seed}"
        # One went on elsewhere, and each began with a policy of its own.
        trained(run, seed, {"start_from": f"runs/{seed}"}, {"workers": 1 + number})
        (run / "config.yaml").write_text(f"train: {{decisions: {planned}}}")
        (run / "summary.json").write_text('{"finished": true, "decisions": 900}')
    (sweep / "2_seed=1" / "checkpoints").mkdir(parents=True)
    (sweep / "2_seed=1" / "config.yaml").write_text("")
    told: list[str] = []
    found = entrants(["sweep", "generalist", "okada"], told.append)
    own = SHIPPED.document.config.seed
    assert [(e.method, e.training_seed) for e in found] == [
        ("sweep", 4),
        ("sweep", 9),
        ("generalist", own),
        ("okada", None),
    ]
    assert [line.partition(":")[0] for line in told] == [
        "sweep/1_seed=9 is not trained to its end; it counts like the others",
        "sweep/2_seed=1 is left out",
    ]
    plan = make_plan(from_words(["terrain=flat"]), found[:2], "none", print)
    assert [entry.named for entry in plan.entries] == ["sweep, seed 4", "sweep, seed 9"]
    assert plan.entries[1].names == {"method": "sweep", "training_seed": 9}
    flat = ("terrain=flat", "terrain.length=0.2", "--episodes", "1", "--output", "out")
    done = call("eval", "sweep", *flat, cwd=Path())
    assert done.code == 0, done.err
    assert "sweep (2 seeds)" in done.out
    for file in ("episodes.csv", "table.csv"):
        rows = list(csv.DictReader((Path("out") / file).read_text().splitlines()))
        assert {row["training_seed"] for row in rows} == {"4", "9", ""}  # a rule has none
        assert {row["method"] for row in rows} == {"sweep", "level", "geometric"}
    summary = json.loads((Path("out") / "summary.json").read_text())
    assert {scene["method"] for scene in summary["scenes"]} == {"sweep", "level", "geometric"}


def test_runs_of_one_seed_that_began_with_several_runs_are_several_methods(sweep: Path) -> None:
    for number, start in enumerate(("a", "b", "a")):
        run = sweep / f"{number}_agent.start_from={start}"
        trained(run, 1, {"start_from": f"runs/{start}"})
    told: list[str] = []
    methods = [entrant.method for entrant in entrants(["sweep"], told.append)]
    assert methods == ["sweep/agent.start_from=a", "sweep/agent.start_from=b"]
    assert len(told) == 1  # the third


def test_methods_of_a_sweep_have_the_names_of_what_was_swept(sweep: Path) -> None:
    names = [f"{n}_agent.learning_rate={rate},seed=1" for n, rate in enumerate((1, 2, 1))]
    for name, rate in zip(names, (0.001, 0.002, 0.001), strict=True):
        trained(sweep / name, 1, {"learning_rate": rate})
    told: list[str] = []
    methods = [entrant.method for entrant in entrants(["sweep"], told.append)]
    assert _swept(Path("0_network.hidden=_64,32_,seed=1")) == "network.hidden=_64,32_"
    assert methods == ["sweep/agent.learning_rate=1", "sweep/agent.learning_rate=2"]
    assert told == [
        f"sweep/{names[2]} is left out: sweep/{names[0]} has its seed and what it learns by"
    ]
