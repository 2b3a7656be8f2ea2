"""Policy improvement by rollouts: each of a policy's best actions is tried in the engine itself.

In: the simulator of an episode, and a policy of Q-values. Out: the action after which the next
decisions of that policy cost least (Tesauro and Galperin 1996). The engine knows the true ground
and robot, so this is a yardstick; it cannot run on a robot.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from flipperctl.api import Outcome, Perception, Simulator, ValuedPolicy
from flipperctl.core.targets import Action, of_rule
from flipperctl.lookahead.settings import RolloutSettings

_FAILED: Final = 2 * math.pi
"""Cost of a failure [rad]."""


class RolloutPolicy:
    """Takes the action after which a policy's next decisions cost least."""

    def __init__(self, settings: RolloutSettings, policy: ValuedPolicy) -> None:
        """``policy`` proposes the actions that are tried, and drives on after them."""
        self._settings, self._policy = settings, policy
        self._simulator: Simulator
        self._taken: Action | None = None

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode, which the simulator follows decision by decision."""
        self._simulator, self._taken = simulator, None

    def act(self, p: Perception) -> Action:
        """Return the cheapest action."""
        # The simulator comes to this decision, with the sensor's memory and noise of the episode.
        simulator = self._simulator
        if self._taken is not None:
            simulator.step(self._taken)
        simulator.perceive()
        now = simulator.save()
        # The policy's own action is the first trial.
        least = math.inf
        for action in self._best(p, self._settings.breadth):
            cost = self._cost(action, least)
            simulator.load(now)
            if cost < least:
                self._taken, least = action, cost
        assert self._taken is not None  # a trial has a finite cost
        return self._taken

    def _best(self, p: Perception, count: int) -> list[Action]:
        """Return the policy's actions with the largest Q-values, the largest first."""
        values = np.asarray(self._policy.q_values(p), np.float64)
        ranked = np.argsort(-values, kind="stable")[:count]
        return [of_rule(int(action), len(p.layout.joints)) for action in ranked]

    def _cost(self, action: Action, bound: float) -> float:
        """Return what the decisions from here on cost that begin with ``action`` [rad].

        A trial ends early where it costs more than ``bound``.
        """
        simulator, settings = self._simulator, self._settings
        start, swing = simulator.state, 0.0
        for _ in range(settings.horizon):
            before = simulator.state
            outcome = simulator.step(action)
            swing += float(np.abs(np.diff(simulator.poses[:, 2])).sum())
            swing += settings.roll * abs(simulator.state.roll - before.roll)
            if outcome is Outcome.REACHED:
                return swing
            if outcome is not None:
                return swing + _FAILED
            if swing > bound:
                return swing
            (action,) = self._best(simulator.perceive(), 1)
        # What is left: the way that others drove meanwhile, and the posture that has to go back.
        end = simulator.state
        behind = simulator.speed * (end.time - start.time) - (end.position[0] - start.position[0])
        posture = abs(end.pitch) + settings.roll * abs(end.roll)
        return float(swing + settings.behind * behind + settings.posture * posture)
