"""Traces in their files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.rollout import trace
from flipperctl.sim.outline import axles


def test_a_trace_of_four_flippers_keeps_each_and_one_of_pairs_its_file(tmp_path: Path) -> None:
    def file_of(**more: Any) -> list[str]:
        count = 3
        still = {n: np.zeros(count) for n in ("time", "pitch", "front", "rear")}
        made = trace.Trace(
            robot=Robot(), ground=np.array([[0.0, 0.0], [1.0, 0.0]]),
            position=np.zeros((count, 2)), decided=np.zeros(1), actions=np.zeros((1, 2)),
            heights=np.zeros((1, 0)), bin_width=0.15, **still, **more,
        )  # fmt: skip
        trace.write(tmp_path / "a.npz", [made])
        (read,) = trace.read(tmp_path / "a.npz")
        assert read.state(1).flippers == made.state(1).flippers
        with np.load(tmp_path / "a.npz") as file:
            return list(file)

    assert "0.flippers" not in file_of()
    angles = np.arange(12).reshape(3, 4) / 8
    assert "0.flippers" in file_of(flippers=angles)
    (read,) = trace.read(tmp_path / "a.npz")
    # From the side, the right flippers come first, and the left ones behind the chassis.
    tips = axles(read.state(1), read.robot)
    assert tips.shape == (5, 2, 2)
    heights = read.robot.flipper_axle * np.sin([angles[1, 1], angles[1, 0]])
    assert [tips[1, 1, 1], tips[3, 1, 1]] == pytest.approx(heights, abs=1e-6)
