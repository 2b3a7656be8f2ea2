"""Tables and words on streams that cannot show everything."""

import io
import sys

import pytest
from rich.cells import cell_len

from flipperctl.cli.main import main
from flipperctl.terminal.console import console
from flipperctl.terminal.streams import plain_streams, spell_plainly

EVAL = ("eval", "--controller", "level", "--episodes", "1", "terrain=flat")


def call_encoded(monkeypatch: pytest.MonkeyPatch, encoding: str, *arguments: str) -> list[str]:
    """The lines on stdout of a command whose streams have this encoding.

    The line on conditions is left out, since its length does not depend on the width.
    """
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    with pytest.raises(SystemExit) as left:
        main(arguments)
    streams[0].flush()
    assert left.value.code == 0
    buffer = streams[0].buffer
    assert isinstance(buffer, io.BytesIO)
    text = buffer.getvalue().decode(encoding)
    return [line for line in text.splitlines() if not line.startswith("conditions ")]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_tables_are_spelt_plainly_and_stay_aligned(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = call_encoded(monkeypatch, encoding, *EVAL)
    assert "theta^_R at decisions [rad]" in lines[2]
    assert "flipper travel [rad]" in lines[2]
    assert len({len(line.rstrip()) for line in lines[1:]}) == 1
    dash = "–" if encoding == "cp1252" else "-"  # which has it
    assert all(line.replace(dash, "-").isascii() for line in lines)


def test_help_and_errors_are_spelt_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "inspect" in " ".join(call_encoded(monkeypatch, "ascii", "--help"))
    lines = call_encoded(monkeypatch, "ascii", "inspect", "plugins", "step")
    assert any(">= -1, <= 1" in line for line in lines)


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
    wide = call_encoded(monkeypatch, "utf-8", *EVAL)
    assert max(map(cell_len, wide)) > 130
    assert not any("…" in line for line in wide)
    monkeypatch.setenv("COLUMNS", "100")
    assert max(map(cell_len, call_encoded(monkeypatch, "utf-8", *EVAL))) <= 100
    monkeypatch.setenv("COLUMNS", "0")
    assert console().width > 1000
