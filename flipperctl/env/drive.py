"""The physical part of an episode: one robot on one profile, from decision to decision.

In: a profile, what the episode drew, where it starts. Out: states and the outcome. It knows
neither observations nor rewards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api import (
    ACTIONS,
    SAMPLE_PERIOD,
    Engine,
    FloatArray,
    Outcome,
    Profile,
    Robot,
    Sensor,
    Start,
    World,
)
from flipperctl.config import Episode
from flipperctl.env.ends import Ends
from flipperctl.guard import fault

_TURN, _LOOK, _END = range(3)
"""What happens within a decision; at one moment, in this order."""


class Drive:
    """World, flipper targets and ends."""

    def __init__(
        self,
        profile: Profile,
        sections: tuple[Engine, Robot, Sensor],
        episode: Episode,
        start: Start,
        period: float,
    ) -> None:
        """``period``: of the decisions [s]."""
        self._engine, self.robot, perception = sections
        try:
            self.world: World = self._engine.place(profile, self.robot, start)
        except BaseException as error:
            raise fault(error, self._engine, "place") from error
        self.ends = Ends(profile, self.robot, episode, start.x, period)
        self.state = self.seen = self.world.state()
        """The state now, and the one that the robot perceives: ``perception.delay`` older."""
        self.poses = self._pose()
        """(S + 1, 5) the last decision at 100 Hz, the pose before it included: x [m], z [m], pitch,
        front and rear flipper angle [rad]."""
        self._target = [start.front, start.rear]
        whole = math.ceil(period / SAMPLE_PERIOD - 1e-9)
        act = min(whole, round(self.robot.actuator_delay / SAMPLE_PERIOD))
        look = max(0, whole - round(perception.delay / SAMPLE_PERIOD))
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
        self.poses = self._pose()
        for moment, what in self._moments:
            while done < moment:
                try:
                    poses = world.advance(moment - done, ends.limits)
                except BaseException as error:
                    raise fault(error, self._engine, "advance") from error
                self.poses = np.concatenate([self.poses, poses])
                if (outcome := ends.instant(world)) is not None:
                    return outcome
                done += len(poses)
            if what == _TURN:
                world.command(*self._target)
            elif what == _LOOK and not self._fresh:
                self.seen = world.state()
        return None

    def _pose(self) -> FloatArray:
        """The pose at the last decision, (1, 5)."""
        world, state = self.world, self.state
        return np.array([[*world.position, world.pitch, state.front, state.rear]])

    def save(self) -> tuple[Any, ...]:
        """All that changes, for ``load``; the engine's contact impulses are not in it."""
        return self.world.save(), self.ends.save(), self.state, self.seen, tuple(self._target)

    def load(self, saved: tuple[Any, ...]) -> None:
        """Go back to what ``save`` gave."""
        world, ends, self.state, self.seen, target = saved
        self.world.load(world)
        self.ends.load(ends)
        self._target = list(target)
