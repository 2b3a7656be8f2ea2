"""Export: a file agrees with torch and describes itself; otherwise nothing is written."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import ObservationLayout
from flipperctl.config import EnvConfig, TrainConfig, parse, resolver
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.errors import ExportError, MissingExtraError
from flipperctl.export import policy
from flipperctl.export.metadata import policy_metadata
from flipperctl.export.policy import compare
from flipperctl.policies.source import PolicySource
from flipperctl.policies.trained import policy_module
from flipperctl.runtime import OnnxPolicy, RobotSetup
from flipperctl.runtime.controller import new_estimator
from flipperctl.runtime.interface import read_interface
from flipperctl.text.files import check_output
from tests.played import play_episodes

SIZE = ObservationLayout().size


@pytest.fixture(scope="module")
def saved(short_run: Path) -> checkpoint.Checkpoint:
    return checkpoint.read(short_run / checkpoint.BEST)


@pytest.fixture(scope="module")
def onnx_file(saved: checkpoint.Checkpoint, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "step.onnx"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(policy, "OBSERVATIONS", 1000)
        found = policy.export(saved, path)
    check_output(path, policy.FILE)  # a file of before is replaced
    assert found["observations"] >= 1000
    assert found["largest_difference"] < 1e-4
    assert found["action_agreement"] == 1.0
    return path


def test_onnx_takes_si_units_in_any_batch(saved: checkpoint.Checkpoint, onnx_file: Path) -> None:
    session = onnxruntime.InferenceSession(onnx_file, providers=["CPUExecutionProvider"])
    (entry,), (result,) = session.get_inputs(), session.get_outputs()
    assert (entry.name, entry.type, entry.shape[1]) == ("observation", "tensor(float)", SIZE)
    assert (result.name, result.type, result.shape[1]) == ("q_values", "tensor(float)", 9)
    module = policy_module(saved)
    rng = np.random.default_rng(0)
    for size in (1, 7):
        observation = rng.uniform(-0.5, 0.5, (size, SIZE)).astype(np.float32)
        expected = module(torch.from_numpy(observation)).numpy()
        actual = session.run(None, {"observation": observation})[0]
        assert actual == pytest.approx(expected, abs=1e-5)


def test_onnx_describes_itself(saved: checkpoint.Checkpoint, onnx_file: Path) -> None:
    model = onnx.load(onnx_file)
    opset = model.opset_import[0].version
    oldest = min(ir for _, ir, ai, *_ in onnx.helper.VERSION_TABLE if ai >= opset)
    assert model.ir_version == oldest  # 8, which onnxruntime reads since 1.14
    properties = {p.key: p.value for p in model.metadata_props}
    layout = json.loads(properties["flipperctl.observation"])
    assert [entry["name"] for entry in layout[-3:]] == ["theta_f1", "theta_f2", "theta_R"]
    assert {entry["frame"] for entry in layout} == {"L", "R"}
    actions = json.loads(properties["flipperctl.actions"])
    assert np.shape(actions) == (9, 2)
    # action = 3·(i + 1) + (j + 1): index 5 is front 0, rear +1 · π/12
    assert actions[5] == pytest.approx([0.0, math.pi / 12])
    assert json.loads(properties["flipperctl.joints"]) == ["front", "rear"]
    targets = json.loads(properties["flipperctl.targets"])
    assert (targets["window"], targets["limit"]) == pytest.approx((math.pi / 12, math.pi / 3))
    assert float(properties["flipperctl.decision_period"]) == pytest.approx(0.6)
    assert json.loads(properties["flipperctl.robot"])["chassis_length"] == 0.76
    assert properties["flipperctl.terrain"] == "step"
    terrain = resolver.to_dict(saved.config().terrain)
    assert json.loads(properties["flipperctl.terrain_config"]) == terrain
    assert properties["flipperctl.seed"] == "7"
    assert float(properties["flipperctl.bin_width"]) == 0.15
    assert {"flipperctl.format_version", "flipperctl.package_version"} <= properties.keys()
    assert str(Path(__file__).parents[2]).encode() not in onnx_file.read_bytes()  # no local path


CHOSEN = {"cell": 0.05, "lane": 0.2, "keep": 64, "half_width": 0.6, "fewest": 12, "deskew": False}
"""Settings of a map, none of them the default."""


def with_lidar(saved: checkpoint.Checkpoint, **settings: object) -> TrainConfig:
    lidar = {"name": "lidar", "pose": "belts", **settings}
    return parse(TrainConfig, {**resolver.to_dict(saved.config()), "perception": lidar})


def test_the_controller_has_the_map_of_the_training(saved: checkpoint.Checkpoint) -> None:
    lidar = policy_metadata(with_lidar(saved, **CHOSEN, noise=0.0))
    stated = json.loads(lidar["flipperctl.map"])
    assert "half_width to each side" in stated.pop("meaning")
    assert stated == {**CHOSEN, "noise": 0.01}  # the map takes no points for more accurate
    assert lidar == {**policy_metadata(saved.config()), "flipperctl.map": lidar["flipperctl.map"]}
    chosen, default = with_lidar(saved, **CHOSEN, noise=0.03), with_lidar(saved)
    for config, exported in ((chosen, chosen), (default, saved.config())):  # planar: the defaults
        in_training = config.perception.estimator(config.robot)
        on_robot = new_estimator(read_interface(policy_metadata(exported), "x"), RobotSetup())
        assert isinstance(in_training, LidarEstimator)
        expected = replace(in_training._settings, accuracy=on_robot._settings.accuracy)
        assert on_robot._settings == expected


def test_the_file_for_another_robot_drives_it_as_the_checkpoint_does(
    saved: checkpoint.Checkpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = []

    def watched(
        module: torch.nn.Module, exported: object, observations: np.ndarray, *more: object
    ) -> object:
        compared.append(observations)
        return compare(module, exported, observations, *more)

    monkeypatch.setattr(policy, "compare", watched)
    path = tmp_path / "narrow.onnx"
    robot = {"angle_limit": 0.4, "flipper_speed": 0.5}
    found = policy.export(saved, path, robot)
    assert found["robot_changes"] == {
        "angle_limit": {"training": math.pi / 3, "file": 0.4},
        "flipper_speed": {"training": math.radians(25), "file": 0.5},
        "decision_period": {"training": 0.6, "file": pytest.approx(math.pi / 12 / 0.5)},
    }
    assert np.abs(compared[0][:, -3:-1]).max() == pytest.approx(0.4, abs=0.01)  # it drove it
    interface = OnnxPolicy(path).interface
    assert (interface.targets.window, interface.targets.limit) == (math.pi / 12, 0.4)
    assert interface.decision_period == pytest.approx(math.pi / 12 / 0.5)
    assert interface.robot["flipper_speed"] == 0.5
    config = EnvConfig(terrain="step", robot=robot)
    sources = PolicySource(checkpoint=path), PolicySource(checkpoint=saved.path)
    ours, theirs = (play_episodes(config, s, episodes=2, seed=1) for s in sources)
    assert ours == theirs


def test_a_mismatch_fails_and_writes_nothing(
    saved: checkpoint.Checkpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flipped(module: torch.nn.Module, *rest: object) -> object:
        return b"", lambda observations: (module(torch.from_numpy(-observations)).detach().numpy(),)

    monkeypatch.setattr(policy, "export_onnx", flipped)
    with pytest.raises(ExportError, match=r"disagrees with torch.*nothing was written"):
        policy.export(saved, tmp_path / "bad.onnx")
    assert list(tmp_path.iterdir()) == []


def test_the_difference_is_stated_beside_what_is_allowed() -> None:
    def exported(observations: np.ndarray) -> tuple[np.ndarray]:
        return (module(torch.from_numpy(observations)).numpy() + np.float32(shift),)

    module = torch.nn.Identity()
    observations = np.full((2, 9), -200.0, np.float32)  # which are their own Q-values
    shift = 0.015  # below 0.0001 · 200
    found = compare(module, exported, observations)
    assert found["largest_difference"] == pytest.approx(0.015, abs=1e-4)
    assert (found["largest_q_value"], found["allowed_difference"]) == pytest.approx((200, 0.02))
    shift = 0.03125
    with pytest.raises(ExportError, match=r"differ by up to 0\.03125.*\(allowed 0\.02\)"):
        compare(module, exported, observations)


def test_a_missing_package_is_named(
    saved: checkpoint.Checkpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    monkeypatch.setattr(policy, "rollout_observations", lambda *_: np.zeros((2, SIZE), np.float32))
    with pytest.raises(MissingExtraError, match=r"needs onnxruntime: pip install"):
        policy.export(saved, tmp_path / "x.onnx")


def test_metadata_have_sides_of_a_layout_with_sides_alone() -> None:
    plain = parse(TrainConfig, {"terrain": "step", "network": "at_d3qn"})
    sided = parse(
        TrainConfig, {**resolver.to_dict(plain), "perception": {"name": "planar", "sides": True}}
    )
    assert "flipperctl.sides" not in policy_metadata(plain)
    interface = read_interface(policy_metadata(sided), "a file")
    assert (interface.sides, interface.heights, interface.size) == (True, 90, 94)
    names = [quantity.name for quantity in interface.observation]
    assert (names[0], names[30], names[75], names[90]) == ("h_1", "left_h_1", "right_top_1", "roll")
    assert names[91:] == ["theta_f1", "theta_f2", "theta_R"]
