"""Tables and words on streams that cannot show everything."""

import io
import re
import sys

import pytest
from rich.cells import cell_len

from flipperctl.cli.main import main
from flipperctl.spelling import spell_plainly
from flipperctl.terminal.console import console
from flipperctl.terminal.streams import plain_streams

EVAL = ("eval", "--controller", "level", "--episodes", "1", "terrain=flat")


def call_encoded(monkeypatch: pytest.MonkeyPatch, encoding: str, *arguments: str) -> list[str]:
    """The lines on stdout of a command whose streams have this encoding."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    with pytest.raises(SystemExit) as left:
        main(arguments)
    streams[0].flush()
    assert left.value.code == 0
    buffer = streams[0].buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode(encoding).splitlines()


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_tables_are_spelt_plainly_and_stay_aligned(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = call_encoded(monkeypatch, encoding, "inspect", "plugins", "step")
    table = [line for line in lines if re.search("bounds|>= ", line)]
    assert len(table) == 4
    assert len({line.index(" m  ") for line in table[1:]}) == 1
    assert table[0].index("unit") == table[1].index(" m  ") + 1
    dash = "–" if encoding == "cp1252" else "-"  # which has it
    assert any(f"[{dash}]" in line for line in call_encoded(monkeypatch, encoding, *EVAL))


def test_help_is_spelt_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "inspect" in " ".join(call_encoded(monkeypatch, "ascii", "--help"))


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("θ̂_R ≥ 0.5…", "theta^_R >= 0.5..."),
        ("2–4 × 10°", "2-4 x 10deg"),
        ("Zürich é", "Zurich e"),
        ("漢", "?"),
    ],
)
def test_spelling(text: str, plain: str) -> None:
    assert spell_plainly(text, "ascii") == plain
    assert spell_plainly(text, "utf-8") == text


def test_bytes_of_a_file_name_come_out_as_they_went_in(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    plain_streams()
    stream.write("r\udcc3\udcbcn")
    stream.flush()
    assert written.getvalue() == "rün".encode()


def test_a_pipe_gets_the_natural_width_or_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    all_columns = (*EVAL, "--columns", "all")
    assert max(map(cell_len, call_encoded(monkeypatch, "utf-8", *all_columns))) > 130
    monkeypatch.setenv("COLUMNS", "100")
    assert max(map(cell_len, call_encoded(monkeypatch, "utf-8", *all_columns))) <= 100
    monkeypatch.setenv("COLUMNS", "0")
    assert console().width > 1000
