"""``inspect config --describe``: every setting with its path, bounds and unit."""

import json
from pathlib import Path
from typing import Any

from tests.cli.call import call


def list_settings(*overrides: str, cwd: Path) -> dict[str, dict[str, Any]]:
    done = call("inspect", "config", "--describe", "--json", *overrides, cwd=cwd)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    by_path = {setting["path"]: setting for setting in found}
    assert len(by_path) == len(found)
    return by_path


def test_it_lists_every_setting_of_the_configuration(tmp_path: Path) -> None:
    changes = ["experiment=generalist", "collector=ray"]
    found = list_settings(*changes, cwd=tmp_path)
    done = call("inspect", "config", *changes, "--json", cwd=tmp_path)
    for path, value in leaves(json.loads(done.out)):
        assert found[path]["value"] == value
    for setting in found.values():
        assert setting["description"]
        if isinstance(setting["value"], float | int) and not isinstance(setting["value"], bool):
            assert setting["bounds"], setting
            assert setting["unit"], setting


def leaves(node: Any, path: str = "") -> list[tuple[str, Any]]:
    """Each value of nested data, under the path that a description gives it."""
    if isinstance(node, dict):
        inner = [
            leaf
            for key, value in node.items()
            for leaf in leaves(value, path if key == "name" else f"{path}.{key}".lstrip("."))
        ]
        return inner if node else []
    if isinstance(node, list) and any(isinstance(item, dict) for item in node):
        return [leaf for i, item in enumerate(node) for leaf in leaves(item, f"{path}[{i}]")]
    return [(path, node)]


def test_values_defaults_and_bounds_of_sections_plugins_and_ranges(tmp_path: Path) -> None:
    changes = ["terrain=mix", "terrain.parts=[{name:ramp,slope_high:20}]", "sim.friction=0.8"]
    found = list_settings(
        *changes, "rewards.pitch.lambda_2=4", "randomise.noise=[0,0.01]", cwd=tmp_path
    )

    def shown(path: str) -> tuple[object, ...]:
        return tuple(found[path][key] for key in ("value", "default", "bounds", "unit"))

    assert shown("sim.friction") == (0.8, 1.0, "> 0, ≤ 10", "-")
    assert shown("terrain") == ("mix", "stair", "", "")
    assert shown("terrain.parts[0].slope_high") == (20.0, 35.0, "> 0, ≤ 60", "°")
    assert shown("rewards.pitch.lambda_2") == (4.0, 8.0, "> 0, ≤ 1000", "1/rad")
    assert shown("randomise.noise") == ([0.0, 0.01], None, "≥ 0, ≤ 0.2", "m")
    assert shown("network.terrain")[2] == "length ≥ 1"
    assert shown("seed") == (1, 1, "≥ 0, ≤ 9.22337e+18", "-")
    assert found["terrain.parts[0]"]["section"] == "terrain.parts[0]"
