"""Tables at any width: no number is cut, and no row loses a cell."""

import io
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.text import Text

from flipperctl.terminal.console import PlainConsole
from flipperctl.terminal.tables import Table
from tests.cli.call import call

WIDTHS = (40, 80, 200)
OUTCOMES = "reached 5 overturned 1 stuck 10 timeout 2"
EVAL = ["eval", "--controller", "okada", "terrain=flat", "conditions=nominal,varied"]
COMMANDS = {
    "eval": [*EVAL, "--baseline", "level", "--passable", "level", "--episodes", "5"],
    "transfer": ["transfer", "--controller", "level", "terrain=flat", "--episodes", "1"],
    "compare": ["inspect", "reward", "--compare", "okada,level", "terrain=flat", "--episodes", "1",
                "rewards=paper,tuned"],
    "regret": ["inspect", "reward", "--regret", "--controller", "okada", "--against", "level",
               "terrain=flat", "--episodes", "5"],
    "audit": ["inspect", "reward", "terrain=flat", "--episodes", "1"],
    "engines": ["inspect", "engines", "terrain=flat", "--episodes", "1"],
    "terrain": ["inspect", "terrain", "stair", "--draws", "3"],
}  # fmt: skip


def printed(table: Table, width: int) -> list[str]:
    stream = io.StringIO()
    table.print(PlainConsole(file=stream, width=width))
    return stream.getvalue().splitlines()


def rates() -> Table:
    table = Table(["terrain", "success", "outcomes", "t_cost [s]"], "okada", words=["outcomes"])
    table.add("stair", "0.833 [0.610, 0.950]", OUTCOMES, "12.0 [9.1, 14.9]")
    table.add("  gap", "1.000 [0.439, 1.000]", "reached 3", "", dim=True)
    return table


def test_a_wide_console_shows_the_rows_side_by_side() -> None:
    title, _, heads, _, first, second, _ = printed(rates(), 110)
    assert title.strip() == "okada"
    assert heads.split("┃")[1:-1] == [
        " terrain ", " success              ", f" {'outcomes':41} ", " t_cost [s]       ",
    ]  # fmt: skip
    assert OUTCOMES in first
    assert first.count("│") == second.count("│") == 5


def test_words_are_wrapped_before_the_rows_are_stacked() -> None:
    lines = printed(rates(), 85)
    assert all("│" in line for line in lines[4:-1])
    assert max(map(cell_len, lines)) == 85
    assert OUTCOMES not in "".join(lines)
    assert "0.833 [0.610, 0.950]" in "".join(lines)


def test_headings_are_wrapped_before_the_rows_are_stacked() -> None:
    table = Table(["terrain", "flipper travel where not reached [rad]"])
    table.add("stair", "1.00 [–]")
    lines = printed(table, 40)
    assert not any("flipper travel" in line for line in lines)
    assert any("stair   │ 1.00 [–]" in line for line in lines)
    assert "flipper travel where not reached [rad]" in printed(table, 60)[1]


def test_a_narrow_console_shows_a_line_for_each_cell() -> None:
    assert printed(rates(), 40) == [
        "okada",
        "stair",
        "  success     0.833 [0.610, 0.950]",
        "  outcomes",
        "    reached 5 overturned 1 stuck 10",
        "    timeout 2",
        "  t_cost [s]  12.0 [9.1, 14.9]",
        "  gap",
        "  success     1.000 [0.439, 1.000]",
        "  outcomes    reached 3",
    ]
    assert printed(rates(), 22)[2:5] == ["  success", "    0.833 [0.610,", "    0.950]"]


def test_a_row_has_a_cell_for_each_heading() -> None:
    with pytest.raises(ValueError, match="2 cells for 4 headings"):
        rates().add("stair", "1")


words = st.lists(st.sampled_from(["a", "θ̂", "é", "[", "1", ".", "…"]), min_size=1, max_size=12)
sentences = st.lists(words.map("".join), min_size=1, max_size=5).map(" ".join)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[sentences] * 4), min_size=1, max_size=3), st.integers(20, 120))
def test_every_word_is_printed_whole_at_every_width(
    rows: list[tuple[str, ...]], width: int
) -> None:
    table = Table(["one", "two words", "three", "four"], words=["four"])
    for row in rows:
        table.add(row[0], Text(row[1]), *row[2:])
    lines = printed(table, width)
    found = " ".join(lines).split()
    assert {word for row in rows for cell in row for word in cell.split()} <= set(found)
    assert max(map(cell_len, lines)) <= width


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_cuts_a_number(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tables: list[Table] = []
    monkeypatch.setattr(Table, "print", lambda table, to: tables.append(table))
    done = call(*COMMANDS[name], cwd=tmp_path)
    assert done.code == 0, done.err
    assert tables
    monkeypatch.undo()
    for table in tables:
        texts = ["\n".join(printed(table, width)) for width in WIDTHS]
        narrow, middle, wide = (sorted(re.findall(r"[-+]?\d+\.\d+", text)) for text in texts)
        assert narrow == middle == wide != []
        assert not any("…" in text for text in texts)
