"""The physical part of an episode: one robot on one profile, from decision to decision.

In: a profile, the sampled settings and the start. Out: states and the outcome. It computes neither
observations nor rewards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from flipperctl.api import (
    SAMPLE_PERIOD,
    CameraWorld,
    EndingWorld,
    Engine,
    FloatArray,
    Outcome,
    Profile,
    RayWorld,
    Robot,
    Sensor,
    Start,
    World,
)
from flipperctl.config import Episode
from flipperctl.core.targets import TargetRule, turns
from flipperctl.env.guarded import place
from flipperctl.env.termination import Termination
from flipperctl.sim.versions import samples_in, simulated

_TURN, _SAMPLE, _PERCEIVE, _END = range(4)
"""Events within a decision; those of one sample happen in this order."""


class DrivenWorld(World, EndingWorld, RayWorld, CameraWorld, Protocol):
    """A world that may terminate by itself, casts rays, has cameras and may measure its work."""

    def flipper_work(self) -> float | None:
        """Return the work of the flippers' motors since the start [J]; None: not measured."""


class Drive:
    """Holds the world, the flippers' targets and the termination of one episode."""

    def __init__(
        self,
        profile: Profile,
        sections: tuple[Engine, Robot, Sensor],
        episode: Episode,
        start: Start,
        period: float,
        rng: np.random.Generator,
    ) -> None:
        """Place the robot; decisions take ``period`` [s], and the engine samples from ``rng``."""
        engine, self.robot, perception = sections
        self.world: DrivenWorld = place(engine, profile, self.robot, start, rng)
        lasting = simulated(period)
        self.termination = Termination(profile, self.robot, episode, start.x, lasting)
        self.state = self.delayed_state = self.world.state()
        """The current state, and the perceived one, which is ``perception.delay`` older."""
        self.poses = self._pose()
        """Poses of the last decision at 100 Hz, the pose before it first, (S + 1, 5): x [m],
        z [m], pitch, front and rear flipper angle [rad]."""
        self.flipper_work: float | None = None
        """Work of the flippers' motors in the last decision [J]; None: not measured."""
        self._work = self.world.flipper_work()
        self._rule = TargetRule(window=self.robot.angle_step, limit=self.robot.angle_limit)
        self._turns = turns(self.robot.angle_step).tolist()
        self.targets = (start.front, start.rear)
        """Commanded angles of the front and the rear flippers in frame R [rad]."""
        samples = samples_in(period)
        turn = min(samples, round(self.robot.actuator_delay / SAMPLE_PERIOD))
        perceive = max(0, samples - round(perception.delay / SAMPLE_PERIOD))
        self._events = sorted([(turn, _TURN), (perceive, _PERCEIVE), (samples, _END)])
        self._undelayed = perceive == samples
        self._samples = 0
        self._samplings: tuple[tuple[int, Callable[[World], None]], ...] = ()
        self._movements: list[Callable[[float, FloatArray], None]] = []

    def sample_every(self, every: int, call: Callable[[World], None]) -> None:
        """Call ``call`` with the world now and after every ``every`` samples of the episode.

        Snapshots include these calls.
        """
        self._samplings = (*self._samplings, (every, call))
        call(self.world)

    def report_poses(self, call: Callable[[float, FloatArray], None]) -> None:
        """Call ``call`` with the current pose and with the poses of later samples, (S, 5).

        Its first argument is the time of the first pose [s].
        """
        self._movements.append(call)
        call(self._samples * SAMPLE_PERIOD, self._pose())

    def decide(self, action: int) -> Outcome | None:
        """Turn the flippers by one action and simulate one decision; return the outcome, if any."""
        state, begun = self.state, self._work
        turned = self._turns[action]
        self.targets = self._rule.next_targets(self.targets, (state.front, state.rear), turned)
        outcome = self._run()
        self._work = ended = self.world.flipper_work()
        self.flipper_work = None if begun is None or ended is None else ended - begun
        self.state = self.world.state()
        if self._undelayed or outcome is not None:
            self.delayed_state = self.state
        return outcome or self.termination.after_decision(float(self.state.position[0]))

    def _run(self) -> Outcome | None:
        world, termination = self.world, self.termination
        done = 0
        self.poses = self._pose()
        for sample, event in self._due_events():
            while done < sample:
                poses = world.advance(sample - done, termination.limits)
                self.poses = np.concatenate([self.poses, poses])
                done += len(poses)
                self._moved(poses)
                last = poses[-1, :3].tolist()
                if (outcome := world.ended() or termination.after_sample(*last)) is not None:
                    self._take_samples()
                    return outcome
            if event == _TURN:
                world.command(*self.targets)
            elif event == _SAMPLE:
                self._take_samples()
            elif event == _PERCEIVE and not self._undelayed:
                self.delayed_state = world.state()
        return None

    def _due_events(self) -> Sequence[tuple[int, int]]:
        """Return the events of the next decision, those of ``sample_every`` included."""
        if not self._samplings:
            return self._events
        (samples, _), now = self._events[-1], self._samples
        every = {period for period, _ in self._samplings}
        due = (n for n in range(1, samples + 1) if any((now + n) % period == 0 for period in every))
        return sorted([*self._events, *((n, _SAMPLE) for n in due)])

    def _take_samples(self) -> None:
        for every, call in self._samplings:
            if self._samples % every == 0:
                call(self.world)

    def _moved(self, poses: FloatArray) -> None:
        self._samples += len(poses)
        for call in self._movements:
            call((self._samples - len(poses) + 1) * SAMPLE_PERIOD, poses)

    def _pose(self) -> FloatArray:
        """Return the pose at the last decision, (1, 5), in the order of ``poses``."""
        state = self.state
        x, z = state.position
        return np.array([[x, z, state.pitch, state.front, state.rear]])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot for ``load``; it lacks the engine's contact impulses."""
        last = self.poses, self.flipper_work
        moving = self.state, self.delayed_state, self.targets, last
        return self.world.save(), self.termination.save(), moving, (self._samples, self._samplings)

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        world, termination, moving, sampling = saved
        self.state, self.delayed_state, self.targets, last = moving
        self.poses, self.flipper_work = last
        self._samples, self._samplings = sampling
        self.world.load(world)
        self._work = self.world.flipper_work()
        self.termination.load(termination)
