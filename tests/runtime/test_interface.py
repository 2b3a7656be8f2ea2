"""The interface of an exported policy, its checksum, and the errors for files of others."""

import math
from pathlib import Path

import pytest

from flipperctl.core.lidar.ground import MapQuality
from flipperctl.errors import PolicyError
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import FORMAT_VERSION, add_checksum, verify
from tests.runtime.linear import MAP, METADATA, RISK, SIZE, write

NEWER = FORMAT_VERSION + 1


def test_the_metadata_describe_inputs_and_outputs(tmp_path: Path) -> None:
    interface = OnnxPolicy(write(tmp_path / "p.onnx")).interface
    assert (interface.size, interface.bins, interface.bin_width) == (SIZE, 15, 0.15)
    assert (interface.highest, interface.heights) == (True, 30)
    assert (interface.frames, interface.inputs) == (1, SIZE)
    names = [q.name for q in interface.observation]
    assert names[14:16] == ["h_15", "top_1"]
    assert names[-4:] == ["top_15", "theta_f1", "theta_f2", "theta_R"]
    assert interface.observation[30].unit == "rad"
    # action = 3·(i + 1) + (j + 1): index 2 is front −1, rear +1
    assert interface.actions.shape == (9, 2)
    assert interface.actions[2].tolist() == pytest.approx([-math.pi / 12, math.pi / 12])
    assert interface.decision_period == 0.6
    assert interface.robot["chassis_length"] == 0.76
    assert (interface.terrain, interface.seed, interface.package_version) == ("stair", 7, "0.3.0")
    assert dict(interface.terrain_config) == {"name": "stair", "rise": 0.15}
    with pytest.raises(ValueError, match="read-only"):
        interface.actions[0] = 0


def test_the_map_of_the_training_is_read_where_the_file_states_it(tmp_path: Path) -> None:
    assert OnnxPolicy(write(tmp_path / "p.onnx")).interface.map_quality is None
    stated = OnnxPolicy(write(tmp_path / "m.onnx", map={"meaning": "x", **MAP})).interface
    assert stated.map_quality == MapQuality(**MAP)


@pytest.mark.parametrize(
    "change",
    [
        *({"cell": value} for value in (0, "1", math.nan)),
        *({"keep": value} for value in (0, 4.5, True)),
        {"deskew": 1},
        *({name: ...} for name in MAP),  # left out
    ],
)
def test_a_wrong_map_is_refused(change: dict, tmp_path: Path) -> None:
    stated = {key: v for key, v in {**MAP, **change}.items() if v is not ...}
    with pytest.raises(
        PolicyError, match=r"flipperctl\.map is .*keep: a whole number above 0, half_width: a"
    ):
        OnnxPolicy(write(tmp_path / "p.onnx", map=stated))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {**dict.fromkeys(METADATA), "checksum": False},
            r"not a file of flipperctl export onnx.*no flipperctl\.format_version",
        ),
        (
            {"format_version": NEWER},
            f"format is '{NEWER}', of another version .*; this one reads {FORMAT_VERSION}",
        ),
        ({"format_version": NEWER, "checksum": False}, f"may be damaged: its format is '{NEWER}'"),
        ({"format_version": None}, "its format is None, of another version"),
        ({"frames": None}, r"flipperctl\.frames is ''"),
        ({"targets": None}, r"flipperctl\.targets is ''"),
        ({"bins": None}, r"flipperctl\.bins is ''.*a whole number above 0 is allowed"),
        ({"bins": 12}, r"flipperctl\.observation is .* a list of 27, each a mapping"),
        ({"highest": False}, r"flipperctl\.observation is .* a list of 18, each a mapping"),
        ({"highest": 1}, r"flipperctl\.highest is '1'.*true or false is allowed"),
        ({"bin_width": -0.15}, r"flipperctl\.bin_width is '-0\.15'.*above 0"),
        ({"frames": 0}, r"flipperctl\.frames is '0'.*a whole number above 0"),
        ({"frames": 2}, rf"tensor\(float\) \['batch', {SIZE}\].*\[batch, {2 * SIZE}\]"),
        ({"decision_period": "soon"}, r"flipperctl\.decision_period is 'soon'"),
        ({"decision_period": math.nan}, r"flipperctl\.decision_period is 'NaN'"),
        ({"joints": ["left", "right"]}, r'flipperctl\.joints is .*\["front", "rear"\]'),
        (
            {"actions": [[0.0, 0.1]] * 8},
            r"flipperctl\.actions is .*a list of 9 or 2, each a list of 2",
        ),
        ({"robot": {"mass": "heavy"}}, r"flipperctl\.robot is .*names to numbers"),
        ({"robot": {"mass": 10**400}}, r"flipperctl\.robot is .*names to numbers"),
        ({"robot": "[" * 100_000}, r"flipperctl\.robot is .*names to numbers"),
        ({"seed": True}, r"flipperctl\.seed is 'true'.*a whole number"),
        ({"terrain_config": None}, r"flipperctl\.terrain_config is ''.*the name 'stair'"),
        ({"terrain_config": {"name": "step"}}, r"flipperctl\.terrain_config is .*'stair'"),
        ({"size": 20}, rf"observation tensor\(float\) \['batch', 20\].*\[batch, {SIZE}\]"),
        *(
            ({"targets": stated}, r"flipperctl\.targets is .*window: a number above 0, limit")
            for stated in ({"window": 0.25}, {"window": 0, "limit": 1.0}, [1, 2])
        ),
        ({"risky": True, "risk": {**RISK, "threshold": 1.5}}, "flipperctl.risk is"),
        ({"risky": True, "risk": {**RISK, "lags": [1, 2]}}, r"lags: \[1, 2, 4, 8, 16\]"),
        ({"risky": True, "risk": {"horizon": 10}}, "flipperctl.risk is"),
        ({"risky": True}, "the model has"),
        ({"risk": RISK}, "the model has"),
        ({"escape": {"temperature": 1.0, "decisions": 4}}, r"escape is .*beside flipperctl\.risk"),
        ({"output": "values"}, r"values tensor\(float\).*q_values tensor\(float\) \[batch, 9\]"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(changes: dict, text: str, tmp_path: Path) -> None:
    path = write(tmp_path / "p.onnx", **changes)
    with pytest.raises(PolicyError, match=text) as found:
        OnnxPolicy(path)
    assert str(path) in str(found.value)
    assert "\n" not in str(found.value)


# The checksum finds every change before anything is parsed


@pytest.fixture
def whole(tmp_path: Path) -> bytes:
    return write(tmp_path / "p.onnx").read_bytes()


def test_every_flipped_bit_is_found(whole: bytes) -> None:
    verify(whole, "p.onnx")
    for at in range(len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << at % 8
        with pytest.raises(PolicyError, match=r"p\.onnx is damaged"):
            verify(bytes(damaged), "p.onnx")


def test_a_truncated_or_longer_file_or_one_without_checksum_is_damaged(
    whole: bytes, tmp_path: Path
) -> None:
    for data in (whole[:-1], whole[: len(whole) // 2], whole + b"\0", whole + whole):
        with pytest.raises(PolicyError, match="is damaged"):
            verify(data, "p.onnx")
    without = write(tmp_path / "q.onnx", checksum=False).read_bytes()
    for data in (without, whole.replace(b"flipperctl.sha256", b"flipperctl.sha257")):
        with pytest.raises(PolicyError, match="damaged: its SHA-256 cannot be found"):
            verify(data, "p.onnx")
    with pytest.raises(ValueError, match=r"must hold flipperctl\.sha256 once"):
        add_checksum(b"no metadata")
