"""Why episodes failed: the sensing or the robot, in one engine and from engine to engine."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pytest

from flipperctl.api import GroundSensor, Profile, RobotState, Sensor, sensor
from flipperctl.config import EvalConfig, with_overrides
from flipperctl.evaluation.engines import explained, steps
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.failure_causes import (
    Cause,
    at_true_pose,
    causes,
    on_true_ground,
    with_friction,
)
from flipperctl.evaluation.plan import Entry, NamedPolicy, Plan
from flipperctl.policies.source import load_policy
from flipperctl.requests.plan import make_plan, scenes
from flipperctl.requests.text import from_words
from flipperctl.sim.planar.sensing import PlanarSensor, TerrainSensor
from flipperctl.views import engines, evaluation
from tests.evaluation.samples import sample

HIGH = ["terrain=step", "terrain.height=0.35", "eval.episodes=2"]


class Level(TerrainSensor):
    """Takes the ground for level, so that no rule lifts its flippers."""

    def sense(self, state: RobotState, rng: np.random.Generator) -> Any:
        found, angles = super().sense(state, rng)
        found.points[:, 1] = -0.1
        found.heights[:] = -0.1
        return found, angles


@pytest.fixture(autouse=True)
def _mapper(registry: dict[Any, Any]) -> None:
    @sensor("mapper")
    class Mapper(Sensor):
        """Sees nothing at a wrong pose, or at any."""

        pose: Literal["true", "belts"] = "belts"
        blind: bool = False

        def over(self, profile: Profile, margin: float) -> GroundSensor:
            exact = self.exact()
            kind = Level if self.blind or self.pose == "belts" else TerrainSensor
            return kind(profile, exact, margin)

        def exact(self) -> PlanarSensor:
            return PlanarSensor(**self.layout.model_dump())


def asked(*words: str) -> list[Any]:
    return scenes(from_words([*HIGH, *words]), None, "okada_published")


def test_a_failure_is_due_to_drift_or_perception_by_what_reaches_instead() -> None:
    ((config, _),) = asked("perception=mapper")
    posed, exact = at_true_pose(config), on_true_ground(config)
    played: list[Any] = []

    def play(chosen: EvalConfig, indices: Sequence[int]) -> list[Any]:
        played.append((chosen, list(indices)))
        reached = {0} if chosen == posed else {1}
        return [sample(i, "reached" if i in reached else "stuck", 1.0) for i in indices]

    failed = [sample(i, "stuck", 1.0) for i in (0, 1, 2)]
    expected = {0: Cause.DRIFT, 1: Cause.PERCEPTION, 2: Cause.OTHER}
    assert causes(config, failed, play) == expected
    assert played == [(posed, [0, 1, 2]), (exact, [1, 2])]
    assert causes(config, [], play) == {}


def test_sensors_of_the_true_ground_have_no_such_causes() -> None:
    ((config, _),) = asked("perception.noise=0.02")
    assert on_true_ground(config) is None
    assert at_true_pose(config) is None
    ((true_pose, _),) = asked("perception=mapper", 'perception.pose="true"')
    assert at_true_pose(true_pose) is None
    assert on_true_ground(true_pose) is not None


@pytest.mark.parametrize(("blind", "cause"), [("false", "drift"), ("true", "perception")])
def test_eval_tells_failures_apart_by_cause(blind: str, cause: str) -> None:
    scenes = asked("perception=mapper", f"perception.blind={blind}")
    result = evaluate(Plan.of_one([Entry(*scene) for scene in scenes], title="okada"))
    (one,) = result.rows
    assert not one.episodes.reached
    assert [row["failed_by"] for row in one.episodes] == [cause, cause]
    document = evaluation.document(result)
    assert document["scenes"][0]["failed_by"] == {cause: 2}
    (row,) = evaluation.policies(document, "okada").rows
    assert f"by {cause} 2" in row["failures"]


def test_engines_have_a_third_step_with_the_sensor() -> None:
    words = [*HIGH[:-1], "eval.episodes=1", "perception=mapper", "sim=planar,mujoco"]
    plan = make_plan(from_words(words), [NamedPolicy("okada_published")], "none", lambda text: None)
    (found,) = evaluation.document(explained(evaluate(plan)))["engines"]
    assert found["planar"]["success_rate"] == found["mujoco"]["success_rate"] == 1.0
    sensed = found["sensed"]
    assert (sensed["sensor"], sensed["summary"]["success_rate"]) == ("mapper", 0.0)
    assert (sensed["kept"], sensed["gap"]["success"]["lost"]) == (0.0, 1)
    assert found["causes"] == {"drift": 1}
    assert found["failures"][0]["default_outcome"] == "reached"


@pytest.mark.parametrize("spread", [None, [0, 1], [0.2, 0.4]])
@pytest.mark.parametrize("engine", ["planar", "mujoco"])
def test_every_sample_of_the_friction_is_doubled(engine: str, spread: object) -> None:
    sampled = {"randomise.sim.friction": [0.4, 0.9], "randomise.spread": spread}
    config = with_overrides(EvalConfig(terrain="step"), {"sim": engine, **sampled})
    more = with_friction(config)
    assert more is not None
    for seed in range(20):
        before, after = (c.sample(np.random.default_rng(seed)) for c in (config, more))
        assert after["sim.friction"] == pytest.approx(2 * before["sim.friction"])


def compared(**settings: Any) -> dict[str, Any]:
    """Return what okada loses from the default engine to ``sim=mujoco``."""
    config = EvalConfig(**settings)
    okada = load_policy("okada", "here")
    entries = [Entry(one, okada, comparison=0) for one in steps(config)]
    (found,) = engines.document(explained(evaluate(Plan(tuple(entries)))))
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
STEEP = {"name": "step", "height": 0.4}
ASIDE = {"offset": 1, "heading_gain": 0, "lateral_slope": 0.5, "friction": 0.5}


@pytest.mark.parametrize(
    ("terrain", "sim", "overturn", "expected"),
    [
        (STEEP, {"friction": 0.6}, None, ("stuck", "traction")),
        (STEEP, {"friction": 0.15}, None, ("stuck", "stuck")),
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
