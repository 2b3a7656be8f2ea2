"""One episode, played by any controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flipperctl.api import RobotState
from flipperctl.env.actions import ALLOWED, action_index
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.run.policy import Acts


def play(
    env: FlipperEnv,
    controller: Acts,
    seed: int,
    trace: list[RobotState] | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Play one episode to its end; returns seed, outcome and the metrics of the episode.

    The states at every decision, start and end included, are appended to ``trace``; ``tell``
    hears what share of its search is done, of a controller that plans ahead.
    """
    env.reset(seed=seed)
    controller.begin(env.simulator(tell))
    while True:
        if trace is not None:
            trace.append(env.state)
        action = controller.act(env.perception)
        if action_index(action) is None:
            raise FlipperctlError(f"{type(controller).__name__}.act returned {action!r}; {ALLOWED}")
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            if trace is not None:
                trace.append(env.state)
            return {"seed": seed, "outcome": str(info["outcome"]), **info["metrics"]}
