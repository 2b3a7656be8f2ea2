"""The commands of an installation without dependencies: the interface printed, and one error."""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from flipperctl.__main__ import main as whole
from flipperctl.runtime.__main__ import main
from tests.runtime.linear import write


@pytest.fixture(autouse=True)
def _handler() -> Iterator[None]:
    """Put the handler of Ctrl-C back, which a program of its own sets."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_has_examples(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["runtime", option])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    assert "python -m flipperctl.runtime stair.onnx" in capsys.readouterr().out.split("Examples")[1]


def test_the_interface_is_printed_as_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["runtime", str(write(tmp_path / "p.onnx"))])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["name", "unit", "frame", "within", "meaning"]
    assert ["0", "h_1", "m", "L", "±6.125", "x"] in lines
    assert ["17", "theta_R", "rad", "L", "±3.142", "pitch"] in lines
    assert ["2", "-15.0", "+15.0"] in lines  # action 2: front down, rear up
    assert ["chassis_length:", "0.76"] in lines


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "python -m flipperctl.runtime stair.onnx; got nothing"),
        (["a.onnx", "b.onnx"], "got a.onnx b.onnx"),
        (["--json"], "got --json"),
        (["none.onnx"], "no such policy file"),
    ],
)
def test_a_wrong_request_is_one_line(
    arguments: list[str],
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["runtime", *arguments])
    with pytest.raises(SystemExit) as left:
        main()
    error = capsys.readouterr().err
    assert (left.value.code, error.count("\n")) == (2, 1)
    assert text in error


def test_the_command_line_without_its_packages_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "flipperctl.cli.main", raising=False)
    monkeypatch.setitem(sys.modules, "typer", None)
    with pytest.raises(SystemExit) as left:
        whole()
    error = capsys.readouterr().err
    assert (left.value.code, error.count("\n")) == (2, 1)
    assert "the package typer is missing: this installation has only flipperctl.runtime" in error
