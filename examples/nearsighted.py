"""A controller of your own that plans on the configured rewards.

Try it: ``flipperctl eval nearsighted terrain=step --episodes 2 --plugins examples/nearsighted.py``
"""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field, PrivateAttr

from flipperctl.api import (
    ACTIONS,
    Controller,
    Perception,
    Policy,
    RewardTerm,
    Simulator,
    Transition,
    action_index,
    controller,
)


@controller("nearsighted")
class Nearsighted(Controller):
    """Take the action with the largest reward if the flippers are held after it."""

    ahead: int = Field(3, ge=1, le=6, description="decisions that are simulated [-]")
    _rewards: Mapping[str, RewardTerm] = PrivateAttr(default_factory=dict)

    def paying(self, rewards: Mapping[str, RewardTerm]) -> Self:
        settings = self.model_copy()
        settings._rewards = rewards
        return settings

    def build(self) -> Policy:
        return Planner(self.ahead, list(self._rewards.values()))


class Planner:
    """Tries every action in the simulator, from the state that the episode is in."""

    def __init__(self, ahead: int, rewards: list[RewardTerm]) -> None:
        self._ahead, self._rewards = ahead, rewards

    def reset(self, simulator: Simulator) -> None:
        self._simulator, self._previous = simulator, (0, 0)

    def act(self, p: Perception) -> int:
        start = self._simulator.save()
        action = max(range(len(ACTIONS)), key=lambda tried: self._reward(tried, start))
        self._simulator.load(start)
        self._simulator.step(action)
        self._previous = ACTIONS[action]
        return action

    def _reward(self, action: int, start: Any) -> float:
        simulator, previous, total = self._simulator, self._previous, 0.0
        simulator.load(start)
        pitches = [simulator.state.pitch]
        for tried in (action, *[action_index(0, 0)] * (self._ahead - 1)):
            before = simulator.state
            outcome = simulator.step(tried)
            after, poses = simulator.state, simulator.poses
            pitches.append(after.pitch)
            decision = Transition(
                before=before,
                after=after,
                pitches=np.array(pitches),
                action=ACTIONS[tried],
                profile=simulator.profile,
                robot=simulator.robot,
                outcome=outcome,
                path=poses[:, :3],
                previous_action=previous,
                flippers=poses[:, 3:],
            )
            total += sum(term.weight * term(decision) for term in self._rewards)
            if outcome is not None:
                break
            previous = ACTIONS[tried]
        return total
