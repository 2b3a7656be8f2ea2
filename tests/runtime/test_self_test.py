"""The self-test: each wrong sign is named, and none passes."""

import json
import math
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flipperctl.errors import PolicyError, RequestError
from flipperctl.runtime import OURS, REP_103, RobotSetup
from flipperctl.runtime.__main__ import _main
from flipperctl.runtime.recordings import SelfTest, read_lines, self_test
from tests.cli.call import call

EXAMPLE = Path(__file__).parents[2] / "examples" / "messages" / "self_test.py"
LINES = [json.dumps(line) for line in runpy.run_path(str(EXAMPLE))["lines"]()]
"""Of a builder who makes every motion, in the signs of REP 103."""


def test_the_command_of_the_robot_answers_as_the_module_does(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.jsonl").write_text("\n".join(LINES))
    status = _main(["--self-test", str(tmp_path / "m.jsonl"), "--signs", "rep103"])
    told = capsys.readouterr().out
    assert (status, told.count("ok (")) == (0, 6)
    assert told.splitlines()[0] == "1 of 6: Raise the front flippers by 15° or more."
    assert told.splitlines()[-1] == "All is right."
    done = call("robot", "self-test", "m.jsonl", "--signs", "rep103", cwd=tmp_path)
    assert (done.code, done.out, done.err) == (status, told, "")
    with (tmp_path / "m.jsonl").open() as pipe:
        monkeypatch.setattr("sys.stdin", pipe)
        assert call("robot", "self-test", "-", cwd=tmp_path).code == 1  # in other signs


def test_each_wrong_sign_is_named(capsys: pytest.CaptureFixture) -> None:
    assert self_test(LINES, "m", RobotSetup(signs=OURS)).wrong == ("front", "pitch")
    other = self_test(LINES, "m", RobotSetup(signs=replace(REP_103, rear=-1, yaw=-1)))
    assert other.wrong == ("rear", "yaw")
    assert not other.passed
    told = capsys.readouterr().out
    assert "front: WRONG: joints changed by -0.2" in told
    assert "rad, which must grow; set signs.front to -1" in told
    assert "set signs.pitch to -1" in told
    assert "set signs.yaw to 1" in told
    assert "Wrong signs: front, pitch." in told
    assert told.count("ok (") == 8


def test_an_x_axis_to_the_rear_is_named() -> None:
    """Odometry tells it at once; a cloud that is turned by π shows a board behind the robot."""
    mount = replace(RobotSetup().mount, x=0.0, axis=math.pi / 2)
    test = SelfTest(RobotSetup(signs=replace(REP_103, x=-1), mount=mount))
    board = np.column_stack([np.full(25, 0.6), np.zeros(25), np.linspace(-0.2, 0.2, 25)])
    for now, messages in read_lines(LINES, "m"):
        points = board if now > 23 else board - (-3, 0, 0)
        test.step(now, **{**messages, "cloud": replace(messages["cloud"], points=points)})
    assert test.wrong == ("x",)
    assert [v.device for v in test.verdicts if v.right is False] == ["odometry", "cloud"]


OTHER = {
    "joints": {"front": ["fl", "-fr"], "rear": ["rl", "-rr"], "scale": math.radians(1)},
    "belts": {"scale": 0.001},
    "lidar": {"x": 0.25, "z": 0.4, "axis": -math.pi / 4},
}


def in_units_of_topics() -> list[str]:
    """The same motions as the joints of another robot tell them, in degrees and mm/s."""
    lines = []
    for text in LINES:
        line = json.loads(text)
        front, rear = (math.degrees(line["joints"][name]) for name in ("front", "rear"))
        line["joints"] = {"fl": front, "fr": -front, "rl": rear, "rr": -rear}
        line["odometry"]["speed"] *= 1000
        lines.append(json.dumps(line))
    return lines


@pytest.mark.parametrize(
    ("change", "wrong", "text"),
    [
        ({}, (), "All is right."),
        ({"signs": "flipperctl"}, ("front",), "change joints.signs, or the - before the names"),
        ({"front": ["fl", "fr"]}, (), "not measured: joints"),
        ({"scale": 1.0}, (), "Refused, as of a wrong unit: joints: an angle of"),
    ],
    ids=["right", "sign", "mirrored", "unit"],
)
def test_units_and_signs_of_the_devices_are_those_of_the_node(
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
    change: dict,
    wrong: tuple[str, ...],
    text: str,
) -> None:
    settings = OTHER | {"joints": OTHER["joints"] | change}
    (tmp_path / "d.json").write_text(json.dumps(settings))
    (tmp_path / "m.jsonl").write_text("\n".join(in_units_of_topics()))
    words = str(tmp_path / "m.jsonl"), f"devices={tmp_path / 'd.json'}"
    status = _main(["--self-test", *words])
    told = capsys.readouterr().out
    assert text in told
    assert status == (0 if text == "All is right." else 1)
    assert all(f"{sign}: WRONG" in told for sign in wrong)
    assert "signs.front to" not in told  # a file of devices has no such key
    done = call("robot", "self-test", *words, cwd=tmp_path)
    assert (done.code, done.out) == (status, told)
    both = call("robot", "self-test", *words, "--signs", "rep103", cwd=tmp_path)
    assert (both.code, both.err.count("\n")) == (2, 1)


def test_a_device_that_is_silent_does_not_pass(capsys: pytest.CaptureFixture) -> None:
    silent = ['{"time": 0, "joints": {"front": 0, "rear": 0}}']
    assert not self_test(silent, "m", RobotSetup()).passed
    assert "not measured: joints, joints, attitude" in capsys.readouterr().out


@pytest.mark.parametrize(
    "line",
    [
        *("[]", '{"time": 1, "arms": {}}', '{"joints": {}}', "{", '{"time": NaN}'),
        f'{{"time": 1{"0" * 400}}}',
    ],
)
def test_another_line_is_refused_by_its_number(line: str) -> None:
    with pytest.raises(PolicyError, match="m, line 2"):
        list(read_lines(['{"time": 0}', line], "m"))


def test_a_file_of_another_encoding_is_named(tmp_path: Path) -> None:
    (tmp_path / "m.jsonl").write_bytes(b"\xff\xfe")
    with pytest.raises(RequestError, match=r"m\.jsonl cannot be read"):
        _main(["--self-test", str(tmp_path / "m.jsonl")])
