"""An exported policy built by hand: the Q-value of action a is the a-th terrain height."""

import json
import math
from pathlib import Path

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from flipperctl.runtime.interface import CHECKSUM, PLACEHOLDER, add_checksum

HEIGHTS = [
    {"name": f"{kind}_{i + 1}", "unit": "m", "frame": "L", "meaning": "x"}
    for kind in ("h", "top")
    for i in range(15)
]
ANGLES = [
    {"name": "theta_f1", "unit": "rad", "frame": "R", "meaning": "front"},
    {"name": "theta_f2", "unit": "rad", "frame": "R", "meaning": "rear"},
    {"name": "theta_R", "unit": "rad", "frame": "L", "meaning": "pitch"},
]
STEP, SIZE = math.pi / 12, len(HEIGHTS + ANGLES)
METADATA = {
    "format_version": 3,
    "package_version": "0.3.0",
    "observation": HEIGHTS + ANGLES,
    "bins": 15,
    "bin_width": 0.15,
    "highest": True,
    "frames": 1,
    "joints": ["front", "rear"],
    "targets": {"meaning": "x", "window": STEP, "limit": math.pi / 3},
    "actions": [[i * STEP, j * STEP] for i in (-1, 0, 1) for j in (-1, 0, 1)],
    "decision_period": 0.6,
    "robot": {"chassis_length": 0.76, "flipper_length": 0.536, "angle_step": STEP},
    "terrain": "stair",
    "terrain_config": {"name": "stair", "rise": 0.15},
    "seed": 7,
}
"""Metadata as ``flipperctl export onnx`` writes them."""
ROBOT = {**METADATA["robot"], "track_radius": 0.1, "track_speed": 0.2, "flipper_speed": 0.436}
RULE = {"window": STEP, "limit": math.pi / 3}
"""What a file for the controller also has: all of the robot, and the rule of its targets."""
PAPER = {"highest": False, "observation": HEIGHTS[:15] + ANGLES, "size": 18}
"""Arguments of ``write`` for the paper's layout."""
ROLL = {"name": "roll", "unit": "rad", "frame": "L", "meaning": "roll"}
SIDES = {
    **{"sides": True, "observation": [*(3 * HEIGHTS), ROLL, *ANGLES], "size": 94, "first": 30},
    "robot": ROBOT,
}
"""Arguments of ``write`` for a policy by the heights below the left tracks."""
FOUR = {
    "joints": ["front_left", "front_right", "rear_left", "rear_right"],
    "observation": [*HEIGHTS, *2 * ANGLES[:2], ANGLES[2]],
    "actions": [[STEP * (a // 3**j % 3 - 1) for j in (3, 2, 1, 0)] for a in range(81)],
    **{"size": 35, "numbers": 81},
}
"""Arguments of ``write`` for a policy of four flippers that turn alone."""
RISK = {"horizon": 10, "threshold": 0.7, "lags": [1, 2, 4, 8, 16], "scale": 0.03}
"""Metadata of a file with a risk."""

RATES = {"output": "rates", "numbers": 2, "actions": [[STEP, 0], [0, STEP]]}
"""Arguments of ``write`` for a file whose rates are the first two heights."""
MAP = {
    **{"cell": 0.05, "lane": 0.2, "keep": 64, "half_width": 0.6, "fewest": 12},
    **{"noise": 0.03, "deskew": False},
}
"""Metadata of a file from a training with a LiDAR whose map has none of the default settings."""


def write(
    path: Path,
    *,
    size: int = SIZE,
    output: str = "q_values",
    numbers: int = 9,
    scale: float = 1.0,
    checksum: bool = True,
    first: int = 0,
    risky: bool = False,
    **changes: object,
) -> Path:
    """Write the policy and return its path; ``changes`` replace metadata, None removes an entry.

    ``first``: number of the height that is the first Q-value. ``risky``: whether it has a risk,
    whose log-odds are the first height, and twice that height for an observation that equals the
    last one.
    """
    weights = numpy_helper.from_array(
        np.eye(size, numbers, -first, dtype=np.float32) * np.float32(scale), "w"
    )
    nodes, held, outputs = (
        [helper.make_node("MatMul", ["observation", "w"], [output])],
        [weights],
        {output: numbers},
    )
    if risky:
        first = np.eye(size, 5, dtype=np.float32)
        first[1:] = 0
        held += [numpy_helper.from_array(first[:, :1], "r"), numpy_helper.from_array(first, "c")]
        nodes += [
            helper.make_node("MatMul", ["observation", "r"], ["odds"]),
            helper.make_node("Sigmoid", ["odds"], ["risk"]),
            helper.make_node("MatMul", ["observation", "c"], ["risk_recurrence"]),
        ]
        outputs |= {"risk": 1, "risk_recurrence": 5}
    graph = helper.make_graph(
        nodes,
        "linear",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", size])],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", length])
            for name, length in outputs.items()
        ],
        held,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    entries = {k: v for k, v in {**METADATA, **changes}.items() if v is not None}
    if isinstance(robot := entries.get("robot"), dict):  # which joints it has, "joints" says
        entries["robot"] = {k: v for k, v in robot.items() if k != "flippers"}
    texts = {
        f"flipperctl.{k}": v if isinstance(v, str) else json.dumps(v) for k, v in entries.items()
    }
    helper.set_model_props(model, texts | ({CHECKSUM: PLACEHOLDER} if checksum else {}))
    data = model.SerializeToString()
    path.write_bytes(add_checksum(data) if checksum else data)
    return path
