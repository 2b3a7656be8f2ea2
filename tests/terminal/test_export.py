"""What ``flipperctl export`` prints of a file for another robot."""

from pathlib import Path

import pytest

from flipperctl.terminal.tables import print_export


def test_a_setting_that_the_training_left_open_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    found = {
        **{"bytes": 1, "observations": 1, "largest_q_value": 1.0, "largest_difference": 0.0},
        **{"allowed_difference": 1e-4, "action_agreement": 1.0},
        "robot_changes": {
            "payload": {"training": None, "file": 5.0},
            "track_speed": {"training": 0.2, "file": 0.3},
        },
    }
    print_export(Path("a.onnx"), Path("run"), found)
    printed = capsys.readouterr().out
    assert "robot.payload 5 kg (training null)" in printed
    assert "robot.track_speed 0.3 m/s (training 0.2)" in printed
