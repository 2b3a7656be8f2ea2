"""The report of an evaluation: its words, its tables, and what it refuses."""

import json
import shutil
from collections.abc import Mapping, Sequence
from html import unescape
from pathlib import Path
from re import findall, sub
from typing import Any

from flipperctl.evaluation.rows import Row
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.rollout.trace import write as write_traces
from flipperctl.text.files import write_json
from flipperctl.text.show import Column, Table, html
from flipperctl.views import evaluation, findings, report
from tests.cli.call import call, refused
from tests.evaluation.samples import result, sample
from tests.figures.test_figures import trace

HOSTILE = '"><script>alert(1)</script>'


def rows(values: Sequence[float], failed: int = 0) -> list[Row]:
    """Episodes with these pitch variations [rad], of which the last ones overturned."""
    outcomes = ["reached"] * (len(values) - failed) + ["overturned"] * failed
    return [sample(i, o, v / 2) for i, (o, v) in enumerate(zip(outcomes, values, strict=True))]


def folder(path: Path, ours: Sequence[Row], others: Mapping[str, Sequence[Row]] = {}) -> Path:
    path.mkdir()
    write_json(path / "summary.json", evaluation.document(result(ours, others)))
    return path


def words(page: str) -> str:
    """The sentences of the summary."""
    (summary,) = findall(r'<ul class="lead">(.*?)</ul>', page.replace("\n", " "))
    return unescape(sub("<[^>]+>", "", summary))


def test_the_summary_says_who_is_best_where_a_policy_is_worse_and_what_failed(
    tmp_path: Path,
) -> None:
    level = rows([1.0, 1.2, 1.1, 1.0, 1.2, 1.1])
    better = words(
        report.page(folder(tmp_path / "a", rows([0.5, 0.6, 0.55] * 2), {"level": level}))
    )
    assert (
        "On step, mine (success 100 %, pitch variation 0.55 rad) is best, with 50 % less" in better
    )
    assert "than level (1.10 rad)." in better
    assert "No policy is clearly worse than level, flippers held still." in better
    assert "All 12 episodes reached the finish." in better
    # It rocks about 1 rad more on the same episodes; the one that failed does not count.
    worse = rows([2.0, 2.3, 2.0, 2.0, 2.3, 9.0], failed=1)
    told = words(report.page(folder(tmp_path / "b", worse, {"level": level})))
    assert "On step, level (success 100 %, pitch variation 1.10 rad) is best" in told
    assert "mine reached the finish in 83.3 %" in told
    assert "Worse than level, flippers held still: mine on step (2.12 rad, not 1.10)" in told
    assert "1 of 12 episodes failed: mine 1 (1 overturned)." in told


def test_the_best_is_told_by_the_same_difference_as_in_the_table(tmp_path: Path) -> None:
    # Scenes differ by more than policies do: their intervals overlap, the differences are clear.
    mine = [0.5, 1.0, 1.5, 0.6, 1.1, 1.6]
    others = {"level": rows([v + 0.4 for v in mine]), "geometric": rows([v + 0.1 for v in mine])}
    where = folder(tmp_path / "a", rows(mine), others)
    page = report.page(where)
    assert "is best, with 9 % less than geometric (1.15 rad) and 28 % less than level" in words(
        page
    )
    assert "-0.1" not in unescape(sub("<[^>]+>", "", findall(r"<table>.*?</table>", page)[0]))


def test_a_failure_of_another_hides_no_difference_that_the_table_shows(tmp_path: Path) -> None:
    # Where failures count, the difference is unclear; on what both reached, it is clear.
    mine = [0.5, 1.0, 1.5, 0.6, 1.1, 1.6]
    theirs = rows([*(v + 0.1 for v in mine[:-1]), 2.0], failed=1)
    told = words(report.page(folder(tmp_path / "a", rows(mine), {"geometric": theirs})))
    assert "not clearly better" not in told
    assert "On step, mine (success 100 %, pitch variation 1.05 rad) is best" in told


def test_few_training_seeds_that_differ_are_named_as_the_reason() -> None:
    def row(policy: str, low: float, high: float, **more: int) -> dict[str, Any]:
        success = {"mean": 1.0, "low": 0.8, "high": 1.0}
        variation = {"mean": (low + high) / 2, "low": low, "high": high}
        own = {"scene": "step", "policy": policy, "success": success}
        return own | {findings.VARIATION: variation} | more

    rivals = [row("rule", 0.9, 1.1), row("mine (2 seeds)", 0.2, 3.0, seeds=2)]
    ((_, told),) = findings._best(rivals, {})
    assert told.endswith(
        "not clearly better than **mine (2 seeds)**, whose few training seeds differ."
    )
    ((_, told),) = findings._best([*rivals[:1], row("other", 0.8, 1.4)], {})
    assert told.endswith("not clearly better than **other**.")


def test_a_page_of_an_interrupted_evaluation_says_how_far_it_went(tmp_path: Path) -> None:
    path = folder(tmp_path / "a", rows([0.5, 0.6, 0.55] * 2))
    assert "interrupted:" not in report.page(path)
    document = json.loads((path / "summary.json").read_text())
    document |= {"interrupted": True, "finished_episodes": 6, "planned_episodes": 9}
    write_json(path / "summary.json", document)
    assert "interrupted: 6 of 9 episodes are finished" in unescape(report.page(path))


def test_a_bar_spans_its_interval_on_the_scale_of_its_scene() -> None:
    def row(scene: str, mean: float, low: float | None, high: float | None) -> dict[str, Any]:
        value = {"mean": mean, "low": low, "high": high}
        return {"scene": scene, "policy": "mine", "value": value, "line": bool(scene)}

    columns = [Column(n, n, named=n != "value") for n in ("scene", "policy", "value")]
    found = html(
        Table(columns, [row("a", 2.0, 1.0, 4.0), row("b", 0.1, None, None)]), {"mine": "p0"}
    )
    assert '<line x1="27.0%" x2="96.0%" y1="50%" y2="50%"/>' in found  # 4 % + 92 % · 1/4 and 4/4
    assert found.count("<circle") == 2
    assert found.count("<line") == 1
    assert '<th class="group" scope="rowgroup" colspan="2">a</th>' in found
    assert found.count('<tr class="" style="--c:var(--p0)">') == 2


def test_names_cannot_leave_the_text(tmp_path: Path) -> None:
    where = folder(tmp_path / "a", rows([1.0, 1.0], failed=1))
    document = json.loads((where / "summary.json").read_text())
    document["scenes"][0]["controller"] = HOSTILE
    document["command"] = f"flipperctl {HOSTILE}"
    write_json(where / "summary.json", document)
    write_traces(where / TRACES, [trace(policy=HOSTILE, scene=HOSTILE, outcome="overturned")])
    page = report.page(where)
    assert "<script>alert" not in page
    assert page.count("</script>") == 2
    (data,) = findall('id="traces">(.*?)</script>', page)
    assert json.loads(data)["policies"][-1] == HOSTILE
    assert json.loads(data)["traces"][0]["scene"] == HOSTILE


def test_the_paper_stands_beside_its_scenes_with_the_conditions_that_repeat_it(
    tmp_path: Path,
) -> None:
    done = call(
        *("eval", "okada", "terrain=paper_step", "--baseline", "none", "--episodes", "1"),
        *("--output", "out"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    page = (tmp_path / "out" / report.FILE).read_text()
    for text in ("AT-D3QN (paper)", "28.07", "3.43", "operators (paper)", "46.17"):
        assert text in page
    assert "Played with conditions=nominal; conditions=paper repeats the experiment." in page
    (scene,) = json.loads((tmp_path / "out" / "summary.json").read_text())["scenes"]
    assert scene["conditions"]["hash"][:8] in page


def test_wrong_folders_and_foreign_files_are_refused(tmp_path: Path) -> None:
    good = folder(tmp_path / "good", rows([1.0]))
    (tmp_path / "mine.html").write_text("my page")
    shutil.copytree(good, tmp_path / "cut")
    (tmp_path / "cut" / TRACES).write_bytes(b"PK")
    shutil.copytree(good, tmp_path / "other")
    (tmp_path / "other" / "summary.json").write_text('{"scenes": [{"name": "older"}]}')
    shutil.copytree(good, tmp_path / "foreign")
    (tmp_path / "foreign" / report.FILE).write_text("my page")
    for arguments, text in {
        ("none",): "none/summary.json: it cannot be read (No such file",
        ("cut",): "cut/traces.npz: it is damaged, or no file of traces",
        ("other",): "other/summary.json: it holds no results of eval, or those of another version",
        ("foreign",): "foreign/report.html exists and is kept",
        ("good", "--output", "mine.html"): "mine.html exists and is kept, since it is not a report",
        ("good", "--output", "a.pdf"): "a.pdf: a report is a .html file",
        ("good", "--output", "no/a.html"): "there is no folder no",
    }.items():
        assert text in refused("report", *arguments, cwd=tmp_path)
    done = call("report", "good", cwd=tmp_path)
    assert (done.code, done.err) == (0, "wrote good/report.html\n")
    assert "These results have no traces of episodes" in (good / report.FILE).read_text()
    assert call("report", "good", cwd=tmp_path).code == 0  # an earlier report is replaced
