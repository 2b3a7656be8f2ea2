"""The commands of an installation without dependencies: the interface printed, and one error."""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from flipperctl.__main__ import main as whole
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.__main__ import describe, main
from tests.cli.call import call
from tests.runtime.linear import MAP, RISK, RULE, write


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
    assert ["input:", "observation,", "float32", "[batch,", "18],", "one", "observation"] in lines
    assert ["output:", "q_values,", "float32", "[batch,", "9]"] in lines
    assert not {"risk:", "escape:", "map:"} & {line[0] for line in lines}


def test_what_the_file_remembers_warns_of_and_draws_is_printed(tmp_path: Path) -> None:
    file = write(
        tmp_path / "p.onnx",
        size=54,
        frames=3,
        targets=RULE,
        risky=True,
        risk=RISK,
        escape={"temperature": 0.1, "decisions": 4},
    )
    lines = describe(OnnxPolicy(file).interface).splitlines()
    assert {
        "input: observation, float32 [batch, 54], the last 3 observations of 18 numbers, oldest "
        "first; at the start of an episode the first one also fills the frames before it",
        "output: risk, float32 [batch, 1], of the input alone",
        "output: risk_recurrence, float32 [batch, 5], what resembling the observations 1, 2, 4, 8, "
        "16 decisions before adds to its log-odds",
        "targets: last target, held within 15.0° of the measured angle, + turn, within ±60.0°",
        "risk: probability of a failure within the next 10 decisions; 0.7 or more is a warning",
        "escape: from a warning on, 4 decisions draw their actions from softmax(q_values / 0.1)",
    } <= set(lines)


def test_inspect_checkpoint_names_the_command_that_shows_an_exported_file(tmp_path: Path) -> None:
    write(tmp_path / "my p.onnx")
    done = call("inspect", "checkpoint", "my p.onnx", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "error: my p.onnx is an exported file, not a checkpoint; "
        "python -m flipperctl.runtime 'my p.onnx' prints its interface, and --check probes it\n"
    )


def test_the_map_of_the_controller_is_printed(tmp_path: Path) -> None:
    lines = describe(OnnxPolicy(write(tmp_path / "p.onnx", map=MAP)).interface).splitlines()
    assert (
        "map: ground within 0.6 m to each side, cells 0.05 m long and 0.2 m wide of up to 64 "
        "points, columns of 12 or more, points with a noise of 0.03 m, not corrected for the "
        "motion in a scan"
    ) in lines


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
