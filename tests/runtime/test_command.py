"""The commands of an installation without dependencies: interface, shadow mode, and one error."""

import json
import math
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flipperctl.__main__ import main as whole
from flipperctl.runtime import JointAngles
from flipperctl.runtime.__main__ import _main, main
from flipperctl.runtime.recordings import Shadow
from tests.cli.call import call
from tests.runtime.linear import MAP, RISK, ROBOT, RULE, SIZE, write
from tests.runtime.messages import IN_CHASSIS, good


@pytest.fixture(autouse=True)
def _handler() -> Iterator[None]:
    """Put the handler of Ctrl-C back, which a program of its own sets."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def test_the_interface_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    escape = {"temperature": 0.1, "decisions": 4}
    more = {"targets": RULE, "risky": True, "risk": RISK, "escape": escape, "map": MAP}
    assert _main([str(write(tmp_path / "p.onnx", size=3 * SIZE, frames=3, **more))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["name", "unit", "frame", "within", "meaning"]
    assert {
        "  0   h_1       m     L      ±6.125  x",
        f"  {SIZE - 1}  theta_R   rad   L      ±3.142  pitch",
        f"input: observation, float32 [batch, {3 * SIZE}], the last 3 observations of {SIZE} "
        "numbers, oldest first; at the start of an episode the first one also fills the frames "
        "before it",
        "output: q_values, float32 [batch, 9]",
        "output: risk, float32 [batch, 1], of the input alone",
        "output: risk_recurrence, float32 [batch, 5], what resembling the observations 1, 2, 4, 8, "
        "16 decisions before adds to its log-odds",
        "  2   -15.0  +15.0",  # front down, rear up
        "targets: last target, held within 15.0° of the measured angle, + turn, within ±60.0°",
        "risk: probability of a failure within the next 10 decisions; 0.7 or more is a warning",
        "escape: from a warning on, 4 decisions draw their actions from softmax(q_values / 0.1)",
        "map: ground within 0.6 m to each side, cells 0.05 m long and 0.2 m wide of up to 64 "
        "points, columns of 12 or more, points with a noise of 0.03 m, not corrected for the "
        "motion in a scan",
        "  chassis_length: 0.76",
    } <= set(lines)
    assert _main([str(write(tmp_path / "plain.onnx"))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"input: observation, float32 [batch, {SIZE}], one observation" in lines
    assert not {"risk:", "escape:", "map:"} & {line.partition(" ")[0] for line in lines}


def test_inspect_checkpoint_names_the_command_that_shows_an_exported_file(tmp_path: Path) -> None:
    write(tmp_path / "my p.onnx")
    done = call("inspect", "checkpoint", "my p.onnx", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "error: my p.onnx is an exported file, not a checkpoint; "
        "python -m flipperctl.runtime 'my p.onnx' prints its interface, and --check probes it\n"
    )


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "python -m flipperctl.runtime stair.onnx; got nothing"),
        (["--json"], "got --json"),
        (["none.onnx"], "no such policy file"),
        (["--self-test", "a", "b"], "expected python -m flipperctl.runtime --self-test MESSAGES"),
        (["--self-test", "a", "--signs", "ros"], "no convention 'ros'; flipperctl, rep103 is all"),
        (["--self-test", "nowhere.jsonl"], "nowhere.jsonl cannot be read"),
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


# Shadow mode on messages: a log for whoever drives, and nothing that moves


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("p") / "p.onnx", robot=ROBOT, targets=RULE)


def test_a_pause_of_the_messages_is_answered_as_a_robots_timer_would(file):
    lines = []
    shadow = Shadow(file, IN_CHASSIS, lines.append)
    for now in (0.0, 0.05, 0.1, 2.0, 2.05, 30.0):
        shadow.take(now, good(now))
    found = shadow.summary()
    assert found["seconds"] == 30.0
    assert found["states"]["stopped"] > 0.5  # from 1.2 s, since nothing came after 0.1 s
    assert found["faults"]["joints_age"]["seconds"] == pytest.approx(1.75, abs=0.1)
    assert set(found["faults"]) == {"joints_age", "clock_jump"}
    assert found["faults"]["clock_jump"]["count"] == 1  # of 28 s
    shadow.take(30.6, {"joints": JointAngles(30.6, math.nan, 0.0)})  # of other joints
    assert all(json.loads(line)["measured"] == [0.1, 0.2] for line in lines)


def test_the_command_prints_the_log_of_lines_of_json(file, tmp_path, capsys):
    told = {
        "time": 0.0,
        "joints": {"front": 0.1, "rear": 0.1},
        "attitude": {"frame": "base_link", "roll": 0.0, "pitch": 0.0, "yaw_rate": 0.0},
    }
    (tmp_path / "m.jsonl").write_text(json.dumps(told) + "\n")
    assert _main(["--shadow", str(file), str(tmp_path / "m.jsonl"), "--signs", "rep103"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["fault"] == "cloud_missing"


def logged(policy: Path, ticks: int) -> tuple[list[dict[str, Any]], Shadow]:
    lines: list[str] = []
    shadow = Shadow(policy, IN_CHASSIS, lines.append)
    for tick in range(ticks):
        shadow.take(tick * 0.05, good(tick * 0.05))
    return lines, shadow


def test_the_risk_is_told_and_logged_while_the_flippers_are_driven(tmp_path: Path) -> None:
    def of(name: str, **risk: Any) -> Path:
        return write(tmp_path / name, robot=ROBOT, targets=RULE, **risk)

    def sigmoid(score: float) -> float:
        return 1 / (1 + math.exp(-score))

    lines, shadow = logged(of("r.onnx", risky=True, risk=RISK), 100)  # level ground 0.1 m below
    told = list(map(json.loads, lines))
    decided = [line["risk"] for line in told if line["action"] is not None]
    assert decided[0] == pytest.approx(sigmoid(-0.1), abs=0.002)
    assert decided[-1] == pytest.approx(sigmoid(-0.2), abs=0.01)
    assert not any(line["warning"] for line in told)
    assert shadow.summary()["warnings"] == 0
    assert shadow.summary()["faults"] == {}  # flippers that follow someone else
    shadow.take(5.5, {})  # nothing arrives any more
    last = json.loads(lines[-1])
    assert (last["state"], last["risk"], last["warning"]) == ("holding", decided[-1], False)
    lines, shadow = logged(of("e.onnx", risky=True, risk={**RISK, "threshold": 0.4}), 100)
    assert shadow.summary()["warnings"] == shadow.summary()["decisions"] == 9
    assert json.loads(lines[-1])["warning"]
    lines, shadow = logged(of("p.onnx"), 30)
    assert not {"risk", "warning"} & set(json.loads(lines[0]))
    assert "warnings" not in shadow.summary()
