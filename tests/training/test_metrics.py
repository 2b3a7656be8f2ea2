"""``metrics.csv`` is only ever appended to, and is the user's where the run did not write it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from flipperctl.errors import CheckpointError, RequestError
from flipperctl.text.files import read_csv
from flipperctl.training.folder import read_run
from flipperctl.training.listeners import Companion, Mark, MetricsCsv

BOM = b"\xef\xbb\xbf"


def append(path: Path, *numbers: int, rows: int = 0, mark: Mark | None = None) -> Mark:
    """Write rows with these decisions; return where the file ends."""
    file = MetricsCsv(path, ["end"], rows=rows, mark=mark, tell=said.append)
    for number in numbers:
        file.episode({"decision": number, "terrain": "a;b"})
    end = file.mark()
    file.close()
    return end


said: list[str] = []


@pytest.fixture
def path(tmp_path: Path) -> Path:
    said.clear()
    return tmp_path / "metrics.csv"


def decisions(path: Path) -> list[str]:
    return [row["decision"] for row in read_csv(path, ("kind",))]


def test_a_resumed_run_cuts_the_file_at_its_checkpoint_and_appends(path: Path) -> None:
    mark = append(path, 1, 2)
    whole = path.read_bytes()
    assert mark.length == len(whole)
    append(path, 3, rows=2, mark=mark)
    with path.open("ab") as file:
        file.write(b"episode,4")
    append(path, 5, rows=2, mark=mark)
    assert path.read_bytes().startswith(whole)
    assert decisions(path) == ["1", "2", "5"]
    assert said == [f"{path}: 1 lines after the checkpoint are cut; the run repeats their episodes"]


EDITS: dict[str, Callable[[bytes], bytes]] = {
    "semicolons": lambda text: text.replace(b",", b";"),
    "floats": lambda text: text.replace(b"episode,1,", b"episode,1.0,"),
    "a cell": lambda text: text.replace(b"episode,2,", b"episode,7,"),
    "a row less": lambda text: b"".join(text.splitlines(keepends=True)[:-1]),
}


@pytest.mark.parametrize("name", EDITS)
@pytest.mark.parametrize("marked", [True, False])
def test_an_edited_file_is_refused_and_kept(name: str, marked: bool, path: Path) -> None:
    mark = append(path, 1, 2)
    if not marked and name in ("floats", "a cell"):
        pytest.skip("a checkpoint of an earlier version tells only where the rows end")
    path.write_bytes(edited := EDITS[name](path.read_bytes()))
    with pytest.raises(CheckpointError, match="and is kept; restore it, or move it away: the run"):
        append(path, 3, rows=2, mark=mark if marked else None)
    assert path.read_bytes() == edited


def test_a_file_that_was_moved_away_begins_anew_with_a_word(path: Path) -> None:
    mark = append(path, 1, 2)
    path.rename(path.with_name("mine.csv"))
    mark = append(path, 3, rows=2, mark=mark)
    assert said == [f"there is no {path}; a new one begins with the rows from here on"]
    append(path, 4, rows=3, mark=mark)
    assert decisions(path) == ["3", "4"]


def test_without_a_mark_nothing_is_cut(path: Path) -> None:
    append(path, 1, 2)
    append(path, 3, rows=2)
    assert decisions(path) == ["1", "2", "3"]
    with pytest.raises(CheckpointError, match="other columns or rows than the 2 rows of the run"):
        append(path, 3, rows=2)
    append(path, 1)  # the run begins again, without any checkpoint
    assert decisions(path) == ["1"]
    assert decisions(path.with_name("metrics.csv_2")) == ["1", "2", "3"]


def test_columns_that_the_file_lacks_are_named(path: Path) -> None:
    mark = append(path, 1)
    more = MetricsCsv(path, ["end", "pitch"], rows=1, mark=mark, tell=said.append)
    more.episode({"decision": 2, "reward_end": 0.5, "reward_pitch": 1})
    more.close()
    assert said == [f"{path} goes on with its columns, which lack reward_pitch"]
    assert [row["reward_end"] for row in read_csv(path)] == ["", "0.5"]


def test_a_kill_before_a_checkpoint_leaves_what_the_one_before_it_states(tmp_path: Path) -> None:
    marks = [Mark(length=number, sha256=f"{number}") for number in range(4)]
    companion = Companion(tmp_path)
    for rows, mark in enumerate(marks[:3]):
        companion.mark = lambda mark=mark: mark
        companion.write(rows)
    companion.announce(b"seed: 1")
    after = Companion(tmp_path).read()
    assert [after.marked(rows) for rows in range(3)] == [None, *marks[1:3]]
    after.mark = lambda: marks[3]
    after.write(1)  # it went on from the checkpoint before
    assert Companion(tmp_path).read().marked(1) == marks[3]
    assert Companion(tmp_path).read().marked(2) is None
    assert after.has_written(b"seed: 1")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            b"kind;decision\nepisode;1\n",
            "names separated by commas are allowed; it has 'kind;decision'",
        ),
        (b"kind,decision\nepisode,1\n\nepisode,2,3\n", "line 4: 3 cells in 2 columns"),
        ("kind,decision\nepisode,1\n".encode("utf-16"), "is not text in UTF-8"),
        (b"kind,decision,kind\n", "line 1: a column is named twice: kind"),
    ],
)
def test_what_cannot_be_read_names_file_and_line(content: bytes, words: str, path: Path) -> None:
    path.write_bytes(content)
    with pytest.raises(RequestError) as error:
        read_csv(path, ("kind", "decision"))
    assert str(error.value).startswith(str(path))
    assert words in str(error.value)


@pytest.mark.parametrize("number", ["inf", "x"])
def test_a_row_at_no_decision_is_named(number: str, path: Path) -> None:
    path.write_text(f"kind,decision\nepisode,1\nepisode,{number}\n")
    with pytest.raises(RequestError, match=r"metrics.csv, line 3: decision: a .*number is allowed"):
        read_run(path.parent)


@pytest.mark.parametrize("content", [b"kind,x\na,1\n", BOM + b"kind,x\r\na,1\r\nb", b"kind,x\na,1"])
def test_a_byte_order_mark_and_a_cut_last_row_are_read(content: bytes, path: Path) -> None:
    path.write_bytes(content)
    assert read_csv(path, ("kind", "x")) == [{"kind": "a", "x": "1"}]
