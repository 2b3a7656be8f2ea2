"""Tables at any width: no number is cut, and no line is longer than the console."""

import io
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from flipperctl.text import show
from flipperctl.text.show import Column, Table, print_table
from tests.cli.call import call

SCENE = ["terrain=flat", "--episodes", "1"]
COMMANDS = {
    "eval": ["eval", "okada", "terrain=flat", "conditions=nominal,varied", "--episodes", "3",
             "--baseline", "level", "--passable", "level", "--columns", "all",
             "--by", "start_shift"],
    "rewards": ["inspect", "reward", "okada", "level", "terrain=flat",
                "rewards=paper,tuned", "--episodes", "1"],
    "conventions": ["inspect", "checkpoint", "generalist", "--check", "sim=planar"],
    "list": ["list", "experiments"],
    "explain": ["explain", "mpc"],
    "compare": ["compare", "judged"],
}  # fmt: skip


def printed(table: Table, width: int) -> list[str]:
    stream = io.StringIO()
    print_table(table, Console(file=stream, width=width))
    return stream.getvalue().splitlines()


def rates() -> Table:
    columns = [
        Column("terrain", "terrain", named=True),
        Column("success", "success"),
        Column("outcomes", "outcomes", wrapped=True),
        Column("time", "time of the reached [s]", 1),
    ]
    interval = {"mean": 12.04, "low": 9.1, "high": 14.9}
    rows = [
        {"terrain": "stair", "success": "83 %", "outcomes": "reached 5 stuck 10", "time": interval},
        {"terrain": "  gap", "success": "100 %", "outcomes": "reached 3", "time": None},
    ]
    return Table(columns, rows, "okada", ["a note of several words"])


def test_a_wide_console_shows_a_line_for_each_row() -> None:
    assert printed(rates(), 80) == [
        "okada",
        "terrain  success  outcomes            time of the reached [s]",
        "stair    83 %     reached 5 stuck 10  12.0 [9.1, 14.9]",
        "  gap    100 %    reached 3           –",
        "a note of several words",
    ]


def test_headings_and_sentences_are_broken_before_columns_continue_below() -> None:
    assert printed(rates(), 50)[1:5] == [
        "terrain  success  outcomes        time of the",
        "                                  reached [s]",
        "stair    83 %     reached 5       12.0 [9.1, 14.9]",
        "                  stuck 10",
    ]
    assert printed(rates(), 34)[1:] == [
        "terrain  success  outcomes",
        "stair    83 %     reached 5",
        "                  stuck 10",
        "  gap    100 %    reached 3",
        "terrain  time of the",
        "         reached [s]",
        "stair    12.0 [9.1, 14.9]",
        "  gap    –",
        "a note of several words",
    ]


def test_a_text_is_broken_but_for_a_command_and_a_path(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    long, path = "word " * 30, "a" * 120
    show.print_text(
        f"{long}\n\nSee {path} there.\nGo: flipperctl eval {path} b\nGo: flipperctl new"
    )
    assert capsys.readouterr().out.splitlines() == [
        *(" ".join(["word"] * 20), " ".join(["word"] * 10), ""),
        *("See", path, "there."),
        *("Go:", f"  flipperctl eval {path} b", "Go: flipperctl new"),
    ]


names = st.text("aθ̂é[.…", min_size=1, max_size=12)
sentences = st.lists(names, min_size=1, max_size=5).map(" ".join)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(names, names, names, sentences), min_size=1, max_size=3), st.data())
def test_every_word_is_printed_whole_at_every_width(
    rows: list[tuple[str, ...]], data: st.DataObject
) -> None:
    width = data.draw(st.integers(40, 120))
    columns = [Column(str(at), "two words", named=at == 0, wrapped=at == 3) for at in range(4)]
    table = Table(columns, [dict(zip("0123", row, strict=True)) for row in rows])
    lines = printed(table, width)
    assert {word for row in rows for cell in row for word in cell.split()} <= {
        word for line in lines for word in line.split()
    }
    assert max(map(cell_len, lines)) <= width


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which ``judged`` has results of several methods."""
    found = tmp_path_factory.mktemp("tables")
    words = ["terrain=flat,step", "--episodes", "2", "--output", "judged"]
    done = call("eval", "okada", "level", "random", *words, cwd=found)
    assert done.code == 0, done.err
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_no_table_breaks_a_line_or_cuts_a_number(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Table] = []
    lines = show.lines
    monkeypatch.setattr(show, "lines", lambda table, to: made.append(table) or lines(table, to))
    monkeypatch.setenv("COLUMNS", "80")
    done = call(*COMMANDS[name], cwd=folder)
    assert done.code == 0, done.err
    assert made
    long = [line for line in done.out.splitlines() if cell_len(line) > 80]
    assert [line for line in long if "/" not in line] == []  # paths are not broken
    monkeypatch.undo()
    for table in made:
        texts = [printed(table, width) for width in (80, 100, 1000)]
        assert max(map(cell_len, texts[0])) <= 80
        assert max(map(cell_len, texts[1])) <= 100
        narrow, middle, wide = (set(re.findall(r"\d+\.\d+", "\n".join(text))) for text in texts)
        assert narrow == middle == wide
