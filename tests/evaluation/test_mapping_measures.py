"""The measures of sensors that map the ground, against numbers worked by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Transition
from flipperctl.cli.plan import scenes
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.views.evaluation import csv_rows, document
from flipperctl.training.listeners import columns

MAPPING = {"map_error", "map_error_below", "drift", "unseen"}


def measured(**perception: object) -> dict[str, float]:
    env = FlipperEnv({"name": "flat", "length": 0.5}, perception=perception)
    env.reset(seed=1)
    while True:
        *_, terminated, truncated, info = env.step(4)
        if terminated or truncated:
            found: dict[str, float] = info["metrics"]
            return found


def episode(bias: float) -> list[Transition]:
    """Decisions of a sensor whose heights are wrong by ``bias`` [m], as if it mapped the ground."""
    env = FlipperEnv("step", perception={"bias": bias})
    env.reset(seed=1)
    made = []
    for _ in range(3):
        env.step(4)
        perceived = env.transition.perception
        assert perceived is not None
        seen = np.arange(15) >= 3
        position = env.transition.before.position * 1.5
        mapped = replace(perceived, seen=seen, position=position)
        made.append(replace(env.transition, perception=mapped))
    return made


def value(name: str, transitions: list[Transition]) -> float:
    measure: Any = resolver.create("measure", name, "test")
    return float(measure(transitions))


def test_a_constant_error_of_the_heights_is_the_map_error() -> None:
    made = episode(0.03)
    assert value("map_error", made) == pytest.approx(0.03, abs=1e-3)
    assert value("map_error_below", made) == pytest.approx(0.03, abs=1e-3)
    assert value("unseen", made) == pytest.approx(3 / 15)
    driven = made[-1].before.position - made[0].before.position
    assert value("drift", made) == pytest.approx(0.5 * np.hypot(*driven))


def test_only_evaluations_of_mapping_sensors_have_them() -> None:
    words = ["terrain=flat", "terrain.length=0.5", "eval.episodes=1"]
    chosen = scenes([*words, "perception=planar,lidar"], None, "level")
    found = document(evaluate(Plan.of_one([Entry(*scene) for scene in chosen])))
    planar, lidar = found["scenes"]
    assert not MAPPING & planar.keys()
    assert lidar.keys() > MAPPING
    rows = list(csv_rows(found))
    assert ["map_error" not in row for row in rows] == [True, False]
    assert not MAPPING & {*columns()}
    assert measured(name="planar").keys() & MAPPING == set()
