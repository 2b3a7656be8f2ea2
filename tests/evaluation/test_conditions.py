"""The hash of the conditions: equal where evaluations are comparable, and only there."""

import hashlib
import json
from pathlib import Path

import pytest

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.evaluation.conditions import Conditions


def of(**overrides: object) -> Conditions:
    base = EvalConfig(terrain="step")
    return Conditions.of(with_overrides(base, overrides))


def test_the_hash_is_that_of_the_canonical_json_of_what_stands_beside_it() -> None:
    found = of().to_dict()
    assert found.pop("name") == "nominal"
    short = found.pop("hash")
    text = json.dumps(found, sort_keys=True, separators=(",", ":"))
    assert short == hashlib.sha256(text.encode()).hexdigest()[:8]
    assert set(found) == {"terrain", "robot", "sim", "perception", "episode", "randomise"}


@pytest.mark.parametrize(
    ("change", "changes"),
    [
        ({"terrain.high": 0.3}, True),
        ({"robot.chassis_mass": 36}, True),
        ({"sim.friction": 0.9}, True),
        ({"perception.noise": 0.01}, True),
        ({"episode.start_noise": 0.1}, True),
        ({"randomise.delay": [0, 0.1]}, True),
        ({"perception.bins": 21, "perception.bin_width": 0.1}, False),
        ({"rewards.pitch.weight": 2}, False),
        ({"eval.seed": 3, "eval.episodes": 5}, False),
        ({"conditions": "trained"}, False),
        ({"robot.chassis_mass": 35}, False),
    ],
)
def test_what_changes_draws_or_physics_changes_the_hash(
    change: dict[str, object], changes: bool
) -> None:
    assert (of(**change).hash != of().hash) == changes


def test_the_hash_covers_the_content_of_recorded_ground(tmp_path: Path) -> None:
    file = tmp_path / "curb.csv"
    settings = {
        "terrain": {"name": "mirror", "terrain": {"name": "profile_file", "path": str(file)}}
    }
    missing = of(**settings)
    assert missing.to_dict()["files"] == [None]
    found = []
    for text in ("x,z\n0,0\n1,0.1\n", "x,z\n0,0\n1,0.2\n"):
        file.write_text(text)
        found.append(of(**settings))
        assert found[-1].to_dict()["files"] == [hashlib.sha256(text.encode()).hexdigest()]
    assert len({missing.hash, *(conditions.hash for conditions in found)}) == 3


def test_the_line_says_what_is_drawn_and_what_differs_from_the_defaults() -> None:
    assert of().line() == ""
    changed = of(
        **{
            "randomise.bias": [-0.01, 0.01],
            "randomise.dropout": [0, 0.2],
            "randomise.perception.pitch_bias": [0, 0.1],
            "perception.noise": 0.01,
            "perception.occlusion": True,
            "sim.friction": 0.8,
            "robot.chassis_mass": 60,
            "episode.start_angle_noise": 0.1,
        }
    )
    assert changed.line() == (
        "randomised dropout 0 to 0.2, bias -0.01 to 0.01 m, perception.pitch_bias 0 to 0.1 rad; "
        "start start_angle_noise 0.1 rad; sensing noise 0.01 m, occlusion on; "
        "physics friction 0.8; robot chassis_mass 60 kg"
    )
    assert of(
        **{f"randomise.{n}": [0, 0.1] for n in ("noise", "dropout", "delay", "angle_noise")}
    ).line() == (
        "randomised noise 0 to 0.1 m, dropout 0 to 0.1, angle_noise 0 to 0.1 rad and 1 more"
    )
    axes = ("sim.friction", "episode.start_noise", "terrain.height")
    assert changed.line(axes).endswith(
        "sensing noise 0.01 m, occlusion on; physics friction varied; robot chassis_mass 60 kg"
    )
