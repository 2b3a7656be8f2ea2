"""Errors of ``mpc``'s prediction model against the engine, one decision ahead.

The model knows the true ground, robot and state before each decision, so that only its
simplifications cause errors: a rigid robot with ideal servos, and long time steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, RobotState
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.controllers import Mpc
from flipperctl.lookahead.model import Model
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, decisions

MEASURES = {"position": "m", "pitch": "rad", "swing": "rad"}
"""Measures of an error and their units: distance of the chassis centres, and absolute differences
of pitch and of the sum of pitch changes within the decision."""


def prediction_errors(
    config: EnvConfig, controller: str, seeds: Sequence[int]
) -> dict[str, list[float]]:
    """Return the errors of each decision of a controller's episodes, by the names of ``MEASURES``.

    The last decision of an episode is left out, since the engine ends it early.
    """
    env = FlipperEnv(config=config)
    policy = PolicySource.of_plugin(controller, "bench.controller").build(config)
    found: dict[str, list[float]] = {name: [] for name in MEASURES}
    for seed in seeds:
        model = None
        for decision in decisions(env, policy, seed):
            if decision.ending is not None:
                break
            model = model or _model(env)
            for name, error in _errors(env, model, decision).items():
                found[name].append(error)
    return found


def _model(env: FlipperEnv) -> Model:
    settings = Mpc(value="")
    return Model(
        env.profile.points,
        env.robot,
        friction=settings.assumed_friction,
        step=settings.step,
        iterations=settings.iterations,
        overturn=settings.overturn,
    )


def _errors(env: FlipperEnv, model: Model, decision: Decision) -> dict[str, float]:
    """Return the error of each measure after the environment's latest decision."""
    t = decision.transition
    targets = np.array([env.drive.targets])
    branch = model.expand(_state(model, t.before)[None], targets, env.config.robot.decision_period)
    variation = np.abs(np.diff(t.path[:, 2])).sum()
    return {
        "position": math.dist(branch.places[0], t.after.position),
        "pitch": abs(float(branch.states[0, 2]) - t.after.pitch),
        "swing": abs(float(branch.pitch_variation[0] - variation)),
    }


def _state(model: Model, state: RobotState) -> FloatArray:
    x, z = map(float, state.position)
    vx, vz = map(float, state.velocity)
    pose, rates = (x, z, state.pitch), (vx, vz, state.pitch_rate)
    return model.state(pose, (state.front, state.rear), rates)
