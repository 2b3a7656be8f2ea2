"""What a failure is played again with."""

import numpy as np
import pytest

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.evaluation.views.engines import with_friction


@pytest.mark.parametrize("spread", [None, [0, 1], [0.2, 0.4]])
@pytest.mark.parametrize("engine", ["planar", "mujoco"])
def test_every_sample_of_the_friction_is_doubled(engine: str, spread: object) -> None:
    sampled = {"randomise.friction": [0.4, 0.9], "randomise.spread": spread}
    config = with_overrides(EvalConfig(terrain="step"), {"sim": engine, **sampled})
    more = with_friction(config)
    assert more is not None
    for seed in range(20):
        before, after = (c.sample(np.random.default_rng(seed)) for c in (config, more))
        assert after["friction"] == pytest.approx(2 * before["friction"])
