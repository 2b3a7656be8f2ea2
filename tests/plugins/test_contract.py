"""Every registered plugin keeps to its contract; further properties of the built-in ones."""

import re
from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import Terrain, registry
from flipperctl.config import resolver
from flipperctl.plugging import plugins
from flipperctl.testing import Check, checks

pytestmark = pytest.mark.slow

FAMILIES = "terrain reward network agent controller sim perception measure logger command"
KINDS = FAMILIES.split()


AT_NIGHT = re.compile(
    r"perception-lidar-(episodes|returns)|.*-another process"
    r"|controller-(?!okada-|greedy|hfc|random|level).*-(actions|repeats|in time)"
    r"|network-.*-onnx|network-(?!noisy).*-trains|agent-(?!d3qn).*-trains"
    r"|command-(?!demo|robot self-test).*-bad input"
    r"|terrain-(?!midway).*-picture"
)
"""They take long, and tests of these rooms and one of their kind prove the same in short."""


plugins.load_commands()
NEEDED = {"profile_file": {"path": str(Path(__file__).with_name("curbs.csv"))}}
"""Settings of plugins that must be given."""
HELD = [
    check
    for (_, name), plugin in list(registry.items())
    if name != "operator"  # it has no drives by default; tests/live/test_drives.py has some
    for check in checks(plugin, settings=NEEDED.get(name, {}))
]


def marks(name: str) -> list[pytest.MarkDecorator]:
    return [pytest.mark.long] * bool(AT_NIGHT.match(name))


@pytest.mark.parametrize(
    "check", [pytest.param(check, marks=marks(str(check))) for check in HELD], ids=str
)
def test_a_plugin_keeps_the_contract(check: Check) -> None:
    check()


def test_every_family_has_its_plugins() -> None:
    assert {kind for kind, _ in registry} == set(KINDS)


# From 1 m before the first edge to 1 m past the last (paper Tab. I)
@pytest.mark.parametrize(("name", "length"), [("paper_step", 5.0), ("paper_stair", 6.5)])
def test_the_paper_s_scenes_have_the_paper_s_length(name: str, length: float) -> None:
    scene = resolver.create("terrain", name, "terrain")
    assert isinstance(scene, Terrain)
    one, other = (scene.generate(np.random.default_rng(seed)) for seed in (0, 1))
    assert one.end - one.start + 2.0 == pytest.approx(length)
    assert np.array_equal(one.points, other.points)  # nothing is drawn
    assert one.points[-1, 1] == pytest.approx(0.0)  # back on the level
