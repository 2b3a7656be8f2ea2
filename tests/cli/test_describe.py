"""``inspect config --describe``: settings with their paths, bounds and units."""

import json
from pathlib import Path

from tests.cli.call import call


def test_values_defaults_and_bounds_of_sections_plugins_and_ranges(tmp_path: Path) -> None:
    changes = ["terrain=mix", "terrain.parts=[{name:ramp,slope_high:20}]", "sim.friction=0.8"]
    changes += ["rewards.pitch.lambda_2=4", "randomise.noise=[0,0.01]"]
    done = call("inspect", "config", "--describe", "--json", *changes, cwd=tmp_path)
    found = {setting["path"]: setting for setting in json.loads(done.out)}
    assert all(setting["description"] for setting in found.values())

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
