"""The tables of the documentation agree with the results in ``docs/results/``."""

import json
import shlex
from pathlib import Path

import pytest
from tests.report.test_card import LEVEL, POLICY

from benchmarks import results, tables
from flipperctl.errors import RequestError

PAGE = "Before.\n\n<!-- results: one.json method reached -->\nold\n<!-- end -->\nAfter.\n"


def test_no_page_disagrees_with_its_results() -> None:
    stale = [str(page) for page, _ in tables.changes()]
    assert stale == [], "run python -m benchmarks.tables"


def test_the_card_and_the_page_of_results_have_tables() -> None:
    marked = {page.name for page in tables.pages() if "<!-- results: " in page.read_text()}
    assert {"generalist.md", "results.md"} <= marked


def test_kept_results_are_those_of_their_commands() -> None:
    every = results.FOLDER.glob("*.json")
    files = {f.stem: json.loads(f.read_text()) for f in every if not f.name.startswith("shipped_")}
    assert set(files) == set(results.COMMANDS)
    for name, document in files.items():
        assert document["command"] == results.COMMANDS[name]
        words = shlex.split(document["command"])
        episodes = int(words[words.index("--episodes") + 1])
        assert {row["episodes"] for row in document["rows"]} == {episodes}


def test_a_table_is_made_anew_between_its_markers(tmp_path: Path) -> None:
    rows = [row.to_dict() for row in (POLICY, LEVEL)]
    (tmp_path / "one.json").write_text(json.dumps({"rows": rows}))
    text = tables.rewritten(PAGE, tmp_path)
    assert text.splitlines()[3:8] == [
        "",
        "| policy | reached |",
        "|---|---|",
        "| `mine` | 97 |",
        "| `level` | 97 |",
    ]
    assert text.startswith("Before.\n")
    assert text.endswith("<!-- end -->\nAfter.\n")
    assert tables.rewritten(text, tmp_path) == text
    with pytest.raises(RequestError, match="no stored results"):
        tables.rewritten(PAGE.replace("one", "two"), tmp_path)
