"""Signs, frames, units and timing hold in both engines, and a flip of any of them is found."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Robot, SensedGround, registry
from flipperctl.config import EvalConfig
from flipperctl.core.targets import TargetRule
from flipperctl.errors import ConformanceError
from flipperctl.plugging import plugins
from flipperctl.sim.mujoco.world import MujocoWorld
from flipperctl.sim.planar.sensing import TerrainSensor
from flipperctl.testing import checks
from flipperctl.testing.conventions import probe_export, probe_sensing, probe_world
from tests.cli.call import call
from tests.runtime import linear

IN_3D = EvalConfig(terrain="flat", sim="mujoco")


def wrong(probes: Any) -> list[str]:
    return [probe.meaning for probe in probes if not probe.holds]


@pytest.mark.parametrize("engine", ["planar", "mujoco"])
@pytest.mark.parametrize("robot", [{}, {"track_speed": 0.4, "flipper_speed": 0.6}])
def test_both_engines_keep_the_conventions(engine: str, robot: dict[str, float]) -> None:
    config = EvalConfig(terrain="flat", sim=engine, robot=robot)
    assert wrong(probe_world(config)) == []
    assert wrong(probe_sensing(config)) == []


def test_a_flipped_pitch_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    pitch = MujocoWorld.pitch.fget
    assert pitch is not None
    monkeypatch.setattr(MujocoWorld, "pitch", property(lambda self: -pitch(self)))
    advance = MujocoWorld.advance  # returns poses (S, 5), the pitch in the third column
    turned = np.array([1, 1, -1, 1, 1])
    monkeypatch.setattr(MujocoWorld, "advance", lambda self, *more: turned * advance(self, *more))
    assert wrong(probe_world(IN_3D)) == [
        "pitch, front flippers pressed down",
        "pitch rate, front flippers pressed down",
        "pitch, rear flippers pressed down",
        "pitch rate, rear flippers pressed down",
        "pitch on a ramp up of 15°, nose up",
    ]


@pytest.mark.parametrize("change", [lambda f, r: (r, f), lambda f, r: (-f, -r)])
def test_swapped_or_flipped_flippers_are_found(
    change: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = MujocoWorld.command
    monkeypatch.setattr(MujocoWorld, "command", lambda self, f, r: command(self, *change(f, r)))
    found = wrong(probe_world(IN_3D))
    assert "front flippers turned up by one action" in found
    assert "pitch, rear flippers pressed down" in found


def test_a_reversed_observation_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sense = TerrainSensor.sense

    def reversed_sense(self: TerrainSensor, *state: Any) -> Any:
        ground, angles = sense(self, *state)
        return SensedGround(ground.points, ground.heights[::-1]), angles

    monkeypatch.setattr(TerrainSensor, "sense", reversed_sense)
    found = wrong(probe_sensing(EvalConfig(terrain="flat")))
    assert found == ["first height, behind the robot", "last height, on the step ahead"]


def test_an_export_s_actions_and_period_are_compared() -> None:
    robot = Robot()
    names = [SimpleNamespace(name=name) for name in ("h_0", "theta_f1", "theta_f2", "theta_R")]
    interface: Any = SimpleNamespace(
        kind="turns",
        actions=np.array(ACTIONS) * robot.angle_step,
        decision_period=robot.decision_period,
        observation=names,
        targets=TargetRule(window=robot.angle_step, limit=robot.angle_limit),
    )
    assert wrong(probe_export(interface, robot, "policy.onnx")) == []
    interface.actions[0, 1] *= -1
    interface.decision_period = 0.5
    interface.targets = TargetRule(window=15.0, limit=60.0)
    interface.observation = names[::-1]
    assert wrong(probe_export(interface, robot, "policy.onnx")) == [
        "turn of the rear pair by action 0",
        "largest target, in both directions",
        "distance between target and angle",
        "time between two actions",
        "order of the angles: front, rear, pitch",
    ]


@pytest.mark.usefixtures("registry")
def test_the_suite_has_the_conventions(monkeypatch: pytest.MonkeyPatch) -> None:
    plugins.load([Path(__file__).parents[2] / "examples"])
    found = {str(one): one for one in checks(*registry.values()) if one.name == "conventions"}
    for one in found.values():
        one()
    time = property(lambda self: 0.02 * self._samples)
    monkeypatch.setattr(MujocoWorld, "time", time)
    with pytest.raises(ConformanceError, match=r"samples is 4\.000 s; 2\.000 ± 0\.000 is allowed"):
        found["sim-mujoco-conventions"]()


def test_the_command_fails_and_names_the_first_convention(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = ("inspect", "checkpoint", "generalist", "--check")
    held = call(*shipped, cwd=tmp_path)
    assert held.code == 0, held.err
    assert "WRONG" not in held.out
    monkeypatch.setattr(MujocoWorld, "time", property(lambda self: 0.02 * self._samples))
    done = call(*shipped, cwd=tmp_path)
    assert done.code == 1
    assert "sim=mujoco: time of 200 samples is 4.000 s; 2.000 ± 0.000 is allowed" in done.err
    other = call(*shipped[:-1], "sim=mujoco", cwd=tmp_path)
    assert (other.code, "sim=mujoco: overrides need --check" in other.err) == (2, True)


def test_the_robot_and_the_observation_of_a_file_are_probed(tmp_path: Path) -> None:
    own = {"track_radius": 0.12, "track_speed": 0.4, "angle_limit": 0.2}
    robot = {**Robot().model_dump(exclude_none=True), **own}
    targets = {"meaning": "x", "window": robot["angle_step"], "limit": 0.2}
    linear.write(tmp_path / "p.onnx", robot=robot, targets=targets, bin_width=0.1)
    probe = ("inspect", "checkpoint", "p.onnx", "--check", "--json")
    done = call(*probe, cwd=tmp_path)
    assert done.code == 0, done.err
    probes = {(p["of"], p["meaning"]): p for p in json.loads(done.out)["probes"]}
    for engine in ("sim=planar", "sim=mujoco"):
        assert probes[engine, "x after driving forward for 2 s"]["expected"] == 0.8
        assert probes[engine, "z of the chassis on level ground, up"]["expected"] == 0.12
        # The end stop holds a pair that one action would turn further.
        assert probes[engine, "front flippers turned up by one action"]["expected"] == 0.2
    assert probes["perception=planar", "first height, behind the robot"]["expected"] == -0.12
    assert probes["p.onnx", "largest target, in both directions"]["found"] == 0.2
    other = call(*probe, "robot.angle_limit=0.3", cwd=tmp_path)
    assert (other.code, json.loads(other.out)["holds"]) == (1, False)
    assert "error: 1 of " in other.err
    assert "first p.onnx: largest target, in both directions is 0.200 rad; 0.300" in other.err
