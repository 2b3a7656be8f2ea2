"""Policy improvement by rollouts: each of a policy's best actions is tried in the engine itself.

In: the simulator of an episode, and a policy of Q-values. Out: the cost of each action, which is
what the next decisions of that policy would cost after it (Tesauro and Galperin 1996). The engine
knows the true ground and robot, so this is a yardstick and a teacher; it cannot run on a robot.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from flipperctl.api import FloatArray, Outcome, Perception, Simulator, ValuedPolicy
from flipperctl.core.targets import Action, of_rule
from flipperctl.lookahead.settings import RolloutSettings

FAILED: Final = 2 * math.pi
"""Cost of a failure, and of an action that was not tried above the dearest that was [rad]."""


class RolloutPolicy:
    """Takes the action after which a policy's next decisions cost least."""

    def __init__(self, settings: RolloutSettings, policy: ValuedPolicy) -> None:
        """``policy`` proposes the actions that are tried, and drives on after them."""
        self._settings, self._policy = settings, policy
        self._simulator: Simulator
        self._taken: tuple[int, float] | None = None

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode, which the simulator follows decision by decision."""
        self._simulator, self._taken = simulator, None

    def act(self, p: Perception) -> Action:
        """Return the cheapest action."""
        action = int(self.costs(p).argmin())
        self.took(action)
        return of_rule(action, len(p.layout.joints))

    def costs(self, p: Perception) -> FloatArray:
        """Return the cost of each action of J joints, (3^J,) [rad]."""
        self._catch_up(p)
        values = np.asarray(self._policy.q_values(p), np.float64)
        tried = np.argsort(-values, kind="stable")[: self._settings.breadth]
        # Each trial begins where the robot is, with the sensor's memory and noise of that instant.
        now, found = self._simulator.save(), np.empty(0)
        for action in map(int, tried):
            bound = found.min(initial=math.inf) + self._settings.worse
            found = np.append(found, self._cost(action, len(p.layout.joints), bound))
            self._simulator.load(now)
        costs = np.full(len(values), found.max() + FAILED)
        costs[tried] = found
        return costs

    def took(self, action: int) -> None:
        """Receive the action that the robot takes."""
        self._taken = action, self._simulator.state.time

    def follow(self, p: Perception, action: int) -> None:
        """Receive an action that another policy takes where nothing is tried."""
        self._catch_up(p)
        self.took(action)

    def _catch_up(self, p: Perception) -> None:
        """Bring the simulator to the decision of ``p``, unless its owner did."""
        simulator = self._simulator
        if self._taken is not None and simulator.state.time == self._taken[1]:
            simulator.step(of_rule(self._taken[0], len(p.layout.joints)))
        simulator.perceive()

    def _cost(self, action: int, joints: int, bound: float) -> float:
        """Return what the decisions from here on cost that begin with ``action`` [rad].

        A trial ends early where it costs more than ``bound``.
        """
        simulator, settings = self._simulator, self._settings
        start, swing = simulator.state, 0.0
        for _ in range(settings.horizon):
            before = simulator.state
            outcome = simulator.step(of_rule(action, joints))
            swing += float(np.abs(np.diff(simulator.poses[:, 2])).sum())
            swing += settings.roll * abs(simulator.state.roll - before.roll)
            if outcome is Outcome.REACHED:
                return swing
            if outcome is not None:
                return swing + FAILED
            if swing > bound:
                return swing
            action = int(np.argmax(self._policy.q_values(simulator.perceive())))
        # What is left: the way that others drove meanwhile, and the posture that has to go back.
        end = simulator.state
        behind = simulator.speed * (end.time - start.time) - (end.position[0] - start.position[0])
        posture = abs(end.pitch) + settings.roll * abs(end.roll)
        return float(swing + settings.behind * behind + settings.posture * posture)
