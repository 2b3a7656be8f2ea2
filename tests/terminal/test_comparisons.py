"""Tables of the differences to each baseline, and whose the lines below several policies are."""

from flipperctl.cli.scenes import scenes
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.results import EvaluationResult, SceneName, SceneResult
from flipperctl.evaluation.scenes import compare
from flipperctl.evaluation.statistics import summarise
from flipperctl.terminal.evaluation import comparisons
from flipperctl.terminal.published import published_table
from tests.evaluation.samples import sample


def row(terrain: str, baselines: dict[str, float], method: str = "") -> SceneResult:
    ours = [sample(i, "reached", 1.0) for i in range(2)]
    others = [
        compare(terrain, ours, name, [sample(i, "reached", value) for i in range(2)])
        for name, value in baselines.items()
    ]
    ((config, _),) = scenes(["conditions=paper", f"terrain={terrain}"], None, "okada")
    summary, name = summarise(terrain, ours), SceneName("", method)
    kept = Conditions.of(config), tuple(others), tuple(ours), name
    return SceneResult("okada", summary, 0, *kept)


def test_a_table_holds_one_baseline_though_another_failed_on_a_scene() -> None:
    both, one = {"mine": 2.0, "level": 3.0}, {"level": 4.0}
    for rows in (
        (row("paper_step", both), row("paper_stair", one)),
        (row("paper_stair", one), row("paper_step", both)),
    ):
        tables = {table.title: table for table in comparisons(EvaluationResult(rows))}
        found = {
            title.split()[2]: {cells[0] for cells, _ in table._rows}
            for title, table in tables.items()
        }
        assert found == {"mine": {"paper_step"}, "level": {"paper_step", "paper_stair"}}


def test_each_policy_s_row_beside_published_results_is_its_own() -> None:
    rows = row("paper_step", {}, "generalist"), row("paper_step", {}, "level")
    table = published_table(EvaluationResult(rows), "generalist, level")
    assert table is not None
    assert [cells[1] for cells, _ in table._rows] == ["generalist", "paper", "level", "paper"]


def test_a_baseline_that_was_stopped_in_the_first_kind_of_a_mix_has_a_row_for_it() -> None:
    ours = [sample(0, "reached", 1.0, "step"), sample(1, "reached", 1.0, "ramp")]
    stopped = compare("mix", ours, "level", [sample(0, "reached", 2.0, "step")])
    ((config, _),) = scenes(["terrain=all_kinds"], None, "okada")
    kept = Conditions.of(config), (stopped,), tuple(ours), SceneName("", "")
    result = EvaluationResult((SceneResult("okada", summarise("mix", ours), 0, *kept),))
    (table,) = comparisons(result)
    assert [str(cells[0]).strip() for cells, _ in table._rows] == ["mix", "step"]
