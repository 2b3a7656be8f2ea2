"""Why an episode failed in another engine, and what it is played again with."""

from typing import Any

import numpy as np
import pytest

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.failure_causes import with_friction
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.views.engines import document, explained, steps
from flipperctl.policies.source import load_policy


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


def compared(**settings: Any) -> dict[str, Any]:
    """Return what okada loses from the default engine to ``sim=mujoco``."""
    config = EvalConfig(**settings)
    okada = load_policy("okada", "here")
    entries = [Entry(one, okada, comparison=0) for one in steps(config)]
    (found,) = document(explained(evaluate(Plan(tuple(entries)))))
    return found


def test_the_gap_is_paired_and_stands_beside_both_summaries() -> None:
    found = compared(terrain="step", sim="mujoco", eval={"episodes": 3})
    assert found["engines"] == ["planar", "mujoco"]
    assert found["planar"]["success_rate"] == found["mujoco"]["success_rate"] == 1.0
    # Three equal pairs prove no equality: |Δ| ≤ z² / (3 + z²) = 0.5615.
    assert found["success_gap"] == found["gap"]["success"] == {
        "mean": 0.0, "low": pytest.approx(-0.5615, abs=1e-4),
        "high": pytest.approx(0.5615, abs=1e-4),
        "episodes": 3, "won": 0, "lost": 0, "p": 1.0, "p_holm": 1.0,
    }  # fmt: skip
    assert (found["kept"], found["failures"], found["causes"]) == (1.0, [], {})
    gap = found["gap"]["t_cost"]
    assert gap["episodes"] == 3
    means = [found[engine]["t_cost"]["mean"] for engine in ("mujoco", "planar")]
    assert gap["mean"] == pytest.approx(means[0] - means[1])


# The belt climbs 0.4 m with a friction of 1, and not with 0.6.
HIGH = {"name": "step", "low": 0.4, "high": 0.4}
ASIDE = {"offset": 1, "heading_gain": 0, "lateral_slope": 0.5, "friction": 0.5}


@pytest.mark.parametrize(
    ("terrain", "sim", "overturn", "expected"),
    [
        (HIGH, {"friction": 0.6}, None, ("stuck", "traction")),
        (HIGH, {"friction": 0.15}, None, ("stuck", "stuck")),
        ("flat", {"lateral_slope": 0.2, "roll_limit": 0.1}, None, ("overturned", "roll")),
        ({"name": "flat", "length": 4}, ASIDE, None, ("overturned", "heading")),
        ("step", {}, 0.1, ("overturned", "overturned")),
    ],
    ids=lambda value: value[1] if isinstance(value, tuple) else "",
)
def test_a_failure_has_its_cause(
    terrain: object, sim: dict[str, float], overturn: float | None, expected: tuple[str, str]
) -> None:
    found = compared(
        terrain=terrain,
        sim={"name": "mujoco", **sim},
        episode={} if overturn is None else {"overturn": overturn},
        eval={"episodes": 1},
    )
    (failure,) = found["failures"]
    assert (failure["outcome"], failure["cause"]) == expected
    assert found["causes"] == {expected[1]: 1}
