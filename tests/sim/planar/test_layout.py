"""Offsets into Chipmunk's structs: they agree with pymunk, and wrong ones are refused."""

import pytest

from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.sim.planar import compiled, layout

# It has the true offsets before a test sets wrong ones, which numba would keep in its cache.
assert compiled.NORMAL == layout.NORMAL


@pytest.mark.parametrize(
    "name", ["NORMAL", "SURFACE", "COUNT", "NORMAL_IMPULSE", "TANGENT_IMPULSE"]
)
def test_an_offset_that_moved_is_refused_before_machine_code_uses_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout.check_layout()
    layout.check_layout.cache_clear()
    monkeypatch.setattr(layout, name, getattr(layout, name) + 1)
    with pytest.raises(ConfigError, match=r"compiled cannot be used with pymunk .*engine=plain"):
        FlipperEnv("flat").reset(seed=0)
    env = FlipperEnv("flat", sim={"name": "planar", "engine": "plain"})
    env.reset(seed=0)
    env.step(4)
    monkeypatch.undo()
    layout.check_layout.cache_clear()
    layout.check_layout()
