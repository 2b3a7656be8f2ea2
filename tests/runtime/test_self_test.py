"""The self-test: each wrong sign is named, and none passes."""

import json
import math
import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flipperctl.core.lidar.body import mounting
from flipperctl.errors import PolicyError, RequestError
from flipperctl.runtime import OURS, REP_103, RobotSetup, Signs
from flipperctl.runtime.__main__ import _main
from flipperctl.runtime.recordings import SelfTest, read_lines, self_test
from tests.cli.call import call

MOUNT = RobotSetup().mount
PERIOD = 0.05


def motions(signs: Signs) -> Iterator[tuple[float, dict]]:
    """Messages of a builder who makes every motion within 4 s, as a robot of these signs sends."""
    heading = 0.0
    for i in range(round(26 / PERIOD)):
        now = PERIOD * i
        part = [min(1.0, max(0.0, (now - 4 * k - 1) / 2)) for k in range(6)]
        turning = 0.4 if 0 < part[3] < 1 else 0.0
        heading += turning * PERIOD
        yield (
            now,
            {
                "joints": {
                    "front": signs.front * 0.5 * part[0],
                    "rear": signs.rear * 0.5 * part[1],
                },
                "attitude": {
                    "frame": "base_link",
                    "roll": 0.0,
                    "pitch": signs.pitch * 0.2 * part[2] * (1 - part[3]),
                    "yaw_rate": signs.yaw * turning,
                },
                "odometry": {"speed": signs.x * (0.2 if 0 < part[4] < 1 else 0.0)},
                "cloud": {"frame": "lidar", "points": scan(signs, part[5] == 1).tolist()},
            },
        )


def scan(signs: Signs, board: bool) -> np.ndarray:
    """Points of a board ahead, and of the ground, in the frame of the LiDAR."""
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-0.2, 0.2, 5))
    ground = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.1)])
    y, z = np.meshgrid(np.linspace(-0.2, 0.2, 5), np.linspace(0.2, 0.6, 5))
    upright = np.column_stack([np.full(y.size, 0.75), y.ravel(), z.ravel()])
    points = np.vstack([ground, upright]) if board else ground
    inside = (points - (MOUNT.x, 0, MOUNT.z)) @ mounting(MOUNT.axis)
    return inside * (signs.x, signs.x, 1)


def write(path: Path, signs: Signs) -> str:
    rows = [json.dumps({"time": time, **messages}) for time, messages in motions(signs)]
    path.write_text("\n".join(rows))
    return str(path)


def test_each_wrong_sign_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    wrong = write(tmp_path / "m.jsonl", Signs(-1, REP_103.rear, -REP_103.pitch, -1))
    assert _main(["--self-test", wrong, "--signs", "rep103"]) == 1
    told = capsys.readouterr().out
    assert "pitch: WRONG" in told
    assert "set signs.yaw to -1" in told
    assert told.endswith("Wrong signs: pitch, yaw.\n")
    assert told.count("right (") == 4


def test_an_x_axis_to_the_rear_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Odometry tells it at once; a cloud that is turned by π shows a board behind the robot."""
    setup = replace(RobotSetup(), mount=replace(MOUNT, x=0.0, axis=math.pi / 2))
    test = SelfTest(setup)
    board = np.column_stack([np.full(25, -0.6), np.zeros(25), np.linspace(-0.2, 0.2, 25)])
    far = board - (3, 0, 0)
    lines = []
    for now, messages in read_lines(json_lines(motions(replace(OURS, x=-1))), "m"):
        messages["cloud"] = replace(messages["cloud"], points=board if now > 23 else far)
        lines.append(test.step(now, **messages))
    assert test.wrong == ("x",)
    assert [v.device for v in test.verdicts if v.right is False] == ["odometry", "cloud"]


def json_lines(motions: Iterator[tuple[float, dict]]) -> Iterator[str]:
    return (json.dumps({"time": time, **messages}) for time, messages in motions)


def test_the_command_of_the_robot_answers_as_the_module_does(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    status = _main(["--self-test", write(tmp_path / "m.jsonl", OURS)])
    told = capsys.readouterr().out
    assert told.splitlines()[0] == "1 of 6: Raise the front flippers by 15° or more."
    assert told.splitlines()[-1] == "All is right."
    done = call("robot", "self-test", "m.jsonl", cwd=tmp_path)
    assert (done.code, done.out, done.err) == (status, told, "")
    with (tmp_path / "m.jsonl").open() as pipe:
        monkeypatch.setattr("sys.stdin", pipe)
        assert call("robot", "self-test", "-", cwd=tmp_path) == done


def test_a_device_that_is_silent_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    file = tmp_path / "m.jsonl"
    file.write_text('{"time": 0, "joints": {"front": 0, "rear": 0}}\n')
    assert _main(["--self-test", str(file)]) == 1
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


def test_the_example_s_builder_makes_every_motion(capsys: pytest.CaptureFixture) -> None:
    example = runpy.run_path(
        str(Path(__file__).parents[2] / "examples" / "messages" / "self_test.py")
    )
    lines = [json.dumps(line) for line in example["lines"]()]
    assert self_test(lines, "the example", RobotSetup(signs=REP_103)).passed
    assert not self_test(lines, "the example", RobotSetup()).passed
    told = capsys.readouterr().out
    assert told.count("right (joints") == 3  # all but the front flippers in the other signs
    assert "Wrong signs: front, pitch." in told
