"""The one loop of an episode that a controller plays.

In: an environment, a controller and a seed. Out: the episode's decisions one by one, or its row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from flipperctl.api import ACTIONS, RobotState, Transition
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError

if TYPE_CHECKING:  # torch, which a rule does not need
    from flipperctl.run.policy import Acts


@dataclass(frozen=True)
class Decision:
    """What one decision did."""

    transition: Transition
    info: dict[str, Any]
    """As ``FlipperEnv.step`` returns it."""


def decisions(
    env: FlipperEnv,
    controller: Acts,
    seed: int,
    tell: Callable[[float], None] = lambda share: None,
) -> Iterator[Decision]:
    """Play an episode and yield each decision after it was made; the last one has the outcome.

    The controller begins the episode before its first decision; ``tell`` is told what fraction of
    its search is done, if it plans ahead.

    Raises:
        FlipperctlError: the controller answered with something that is no action.
    """
    env.reset(seed=seed)
    controller.begin(env.simulator(tell))
    over = False
    while not over:
        action = controller.act(env.perception)
        if action not in range(len(ACTIONS)):
            raise FlipperctlError(
                f"{type(controller).__name__}.act returned {action!r}; "
                f"0 to {len(ACTIONS) - 1} is allowed"
            )
        _, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        yield Decision(env.transition, info)


def play(
    env: FlipperEnv,
    controller: Acts,
    seed: int,
    trace: list[RobotState] | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Play one episode to its end; returns seed, outcome and the metrics of the episode.

    The states at every decision, start and end included, are appended to ``trace``; ``tell`` is
    that of ``decisions``.
    """
    info: dict[str, Any] = {}
    for index, decision in enumerate(decisions(env, controller, seed, tell)):
        if trace is not None:
            if index == 0:
                trace.append(decision.transition.before)
            trace.append(decision.transition.after)
        info = decision.info
    return {"seed": seed, "outcome": str(info["outcome"]), **info["metrics"]}
