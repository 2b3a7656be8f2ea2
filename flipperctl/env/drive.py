"""The physical part of an episode: one robot on one profile, from decision to decision.

In: a profile, what the episode drew, where it starts. Out: states and the outcome. It knows
neither observations nor rewards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api import ACTIONS, Outcome, Profile
from flipperctl.config import Episode, PerceptionSettings, Robot, Sim
from flipperctl.env.ends import Ends
from flipperctl.sim.planar.world import SAMPLE, World

_TURN, _LOOK, _END = range(3)
"""What happens within a decision; at one moment, in this order."""


class Drive:
    """World, flipper targets and ends."""

    def __init__(
        self,
        profile: Profile,
        sections: tuple[Sim, Robot, PerceptionSettings],
        episode: Episode,
        start: tuple[float, float, float],
        period: float,
    ) -> None:
        """``start``: x [m], front and rear angle [rad]; ``period``: of the decisions [s]."""
        sim, self.robot, perception = sections
        self.world = World(profile, self.robot, sim, *start)
        self.ends = Ends(profile, self.robot, episode, start[0], period)
        self.state = self.seen = self.world.state()
        """The state now, and the one that the robot perceives: ``perception.delay`` older."""
        self.path = np.array([[*self.world.position, self.world.pitch]])
        """The last decision at 100 Hz: x [m], z [m] and pitch [rad], (S + 1, 3)."""
        self._target = list(start[1:])
        whole = math.ceil(period / SAMPLE - 1e-9)
        act = min(whole, round(self.robot.actuator_delay / SAMPLE))
        look = max(0, whole - round(perception.delay / SAMPLE))
        self._moments = sorted([(act, _TURN), (look, _LOOK), (whole, _END)])
        self._fresh = look == whole

    def decide(self, action: int) -> Outcome | None:
        """Turn the flippers by one action and let the world run for one decision."""
        robot = self.robot
        self._target = [
            robot.clip(target + turn * robot.angle_step)
            for target, turn in zip(self._target, ACTIONS[action], strict=True)
        ]
        outcome = self._run()
        self.state = self.world.state()
        if self._fresh or outcome is not None:
            self.seen = self.state
        return outcome or self.ends.decision(float(self.state.position[0]))

    def _run(self) -> Outcome | None:
        world, ends = self.world, self.ends
        done = 0
        self.path = np.array([[*world.position, world.pitch]])
        for moment, what in self._moments:
            while done < moment:
                poses = world.advance(moment - done, ends.limits)
                self.path = np.concatenate([self.path, poses])
                if (outcome := ends.instant(world)) is not None:
                    return outcome
                done += len(poses)
            if what == _TURN:
                world.command(*self._target)
            elif what == _LOOK and not self._fresh:
                self.seen = world.state()
        return None

    def save(self) -> tuple[Any, ...]:
        """All that changes, for ``load``; the engine's contact impulses are not in it."""
        return self.world.save(), self.ends.save(), self.state, self.seen, tuple(self._target)

    def load(self, saved: tuple[Any, ...]) -> None:
        """Go back to what ``save`` gave."""
        world, ends, self.state, self.seen, target = saved
        self.world.load(world)
        self.ends.load(ends)
        self._target = list(target)
