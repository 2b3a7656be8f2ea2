"""The commands of an installation without dependencies: the interface printed, and one error."""

import sys
from pathlib import Path

import pytest

from flipperctl.__main__ import main as whole
from flipperctl.runtime.__main__ import main
from tests.runtime.linear import write


def test_the_interface_is_printed_as_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["runtime", str(write(tmp_path / "p.onnx"))])
    main()
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["name", "unit", "frame", "within", "meaning"]
    assert ["0", "h_1", "m", "L", "±6.125", "x"] in lines
    assert ["17", "theta_R", "rad", "L", "±3.142", "pitch"] in lines
    assert ["2", "-15.0", "+15.0"] in lines  # action 2: front down, rear up
    assert ["chassis_length:", "0.76"] in lines


@pytest.mark.parametrize(
    ("arguments", "text"),
    [([], "usage: python -m flipperctl.runtime FILE"), (["none.onnx"], "no such policy file")],
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
