"""The physical part of an episode: one robot on one profile, from decision to decision.

In: a profile, the sampled settings and the start. Out: states and the outcome. It computes neither
observations nor rewards.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flipperctl.api import (
    SAMPLE_PERIOD,
    Command,
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
from flipperctl.core.targets import (
    Action,
    Rates,
    TargetRule,
    action_index,
    actions_of,
    alike,
    angles_of,
    closest,
)
from flipperctl.env.placed import PlacedWorld, place
from flipperctl.env.termination import Termination
from flipperctl.errors import NonFiniteError
from flipperctl.sim.versions import samples_in, simulated

_TURN, _SAMPLE, _PERCEIVE, _END = range(4)
"""Events within a decision, in their order within a sample."""
_DRIVEN = 0.9
"""Mean share of the belts' speed from which a decision counts as driven ahead [-]."""


Targets = tuple[float, ...]
"""Angle of each joint, (J,) [rad]."""


def closest_action(
    before: Targets, after: Targets, step: float, limit: float
) -> tuple[int, Targets]:
    """Return the action closest to a turn of the joints, and where it leads from ``before`` [rad].

    ``step``: turn of an action, ``limit``: largest target [rad]. The rest of the way stays for the
    next decision.
    """
    moves = [min(1, max(-1, round((a - b) / step))) for b, a in zip(before, after, strict=True)]
    ends = [min(limit, max(-limit, b + m * step)) for b, m in zip(before, moves, strict=True)]
    return action_index(*moves), tuple(ends)


class Commanding:
    """The commands of an operator within the decisions of one episode."""

    def __init__(
        self, interval: int, call: Callable[[World], Command], lag: int, limit: float, step: float
    ) -> None:
        """Ask ``call`` every ``interval`` samples; a command takes effect ``lag`` calls later.

        ``limit``: largest target [rad]; ``step``: turn of an action [rad].
        """
        self.every = interval
        self.commands: list[Command] = []
        """Commands since the last ``end``."""
        self._call, self._lag, self._limit, self._step = call, lag, limit, step
        self._waiting: deque[Command] = deque()
        self._belts = 1.0
        self._followed: Targets | None = None

    def command(self, world: PlacedWorld, targets: Targets) -> Targets:
        """Ask for a command and apply the one that is due; return the new targets [rad]."""
        # The first command of an episode starts from the targets of its start.
        self._followed = self._followed or targets
        command = self._call(world)
        if not all(map(math.isfinite, command.numbers)):
            raise NonFiniteError(
                f"an operator's command has a number that is not finite: {command}"
            )
        # Of four flippers each command has four angles, so that recorded rows are equally long.
        if len(targets) > 2 and not command.flippers:
            command = command._replace(flippers=alike((command.front, command.rear), len(targets)))
        self.commands.append(command)
        self._waiting.append(command)
        # The actuators' delay: a command takes effect some calls later.
        if len(self._waiting) <= self._lag:
            return targets
        due = self._waiting.popleft()
        limit, belts = self._limit, min(1.0, max(-1.0, due.belts))
        targets = tuple(min(limit, max(-limit, float(angle))) for angle in angles_of(due))
        world.command(*targets)
        if belts != self._belts:
            world.run_belts(belts)
            self._belts = belts
        return targets

    def end(self, targets: Targets) -> tuple[int, FloatArray]:
        """Return the action closest to the last decision's commands, and these as ``numbers``.

        Turns that an action could not express go to the next one, so that the sum of the actions
        follows the targets.
        """
        before = self._followed or targets
        action, self._followed = closest_action(before, targets, self._step, self._limit)
        numbers = [command.numbers for command in self.commands]
        commands, self.commands = np.array(numbers, np.float64), []
        return action, commands


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
        *,
        checked: bool = True,
    ) -> None:
        """Place the robot; decisions take ``period`` [s], and the engine samples from ``rng``.

        ``checked``: whether every value of the engine's world is checked.
        """
        engine, self.robot, perception = sections
        self.world = place(engine, profile, self.robot, start, rng, checked=checked)
        lasting = simulated(period)
        self.termination = Termination(profile, self.robot, episode, start.x, lasting)
        self.state = self.delayed_state = self.world.state()
        """The current state, and the perceived one, which is ``perception.delay`` older."""
        self.poses = np.array([self._pose()])
        """Poses of the last decision at 100 Hz, the pose before it first, (S + 1, 3 + J): x [m],
        z [m], pitch and the angle of each joint [rad]."""
        self.flipper_work: float | None = None
        """Work of the flippers' motors in the last decision [J]; None: not measured."""
        self.roll_variation: float | None = None
        """Sum of the absolute roll changes in the last decision at 100 Hz [rad]; None: in 2-D."""
        self._sums = self.world.sums()
        self._rule = TargetRule(window=self.robot.angle_step, limit=self.robot.angle_limit)
        joints = len(self.robot.joints)
        self.moves = actions_of(joints)
        """Turn of each joint by each action, (3^J, J) [angle steps]."""
        self.targets = alike((start.front, start.rear), joints)
        """Commanded angle of each joint in frame R, (J,) [rad]."""
        # Events in samples: the delayed turn, the perception before the end by its delay, the end.
        samples = samples_in(period)
        turn = min(samples, round(self.robot.actuator_delay / SAMPLE_PERIOD))
        perceive = max(0, samples - round(perception.delay / SAMPLE_PERIOD))
        self._events = sorted([(turn, _TURN), (perceive, _PERCEIVE), (samples, _END)])
        self._undelayed = perceive == samples
        self.action = action_index(*(0,) * joints)
        """Index of the last action; of rates and of an operator, the one that came closest."""
        self.rates: Rates | None = None
        """Rates of the last action; None of an index and of an operator."""
        self.commands: FloatArray | None = None
        """An operator's commands in the last decision, (K, 5), of four flippers (K, 9)."""
        self._turn_at = turn
        self._operator: Commanding | None = None
        self._samples = 0
        self._samplings: tuple[tuple[int, Callable[[World], None]], ...] = ()
        self._movements: list[Callable[[float, FloatArray], None]] = []

    def sample_every(self, interval: int, call: Callable[[World], None]) -> None:
        """Call ``call`` with the world now and after every ``interval`` samples of the episode.

        Snapshots include these calls.
        """
        self._samplings = (*self._samplings, (interval, call))
        call(self.world)

    def report_poses(self, call: Callable[[float, FloatArray], None]) -> None:
        """Call ``call`` with the current pose and with the poses of later samples.

        Its first argument is the time of the first pose [s].
        """
        self._movements.append(call)
        call(self._samples * SAMPLE_PERIOD, np.array([self._pose()]))

    def operate(self, interval: int, call: Callable[[World], Command]) -> None:
        """Let ``call`` command flippers and belts at each decision's start and at intervals in it.

        ``interval``: samples between two calls.
        ``robot.actuator_delay`` is rounded to these calls. Standing belts are no standstill.
        """
        lag = round(self._turn_at / interval)
        limit, step = self.robot.angle_limit, self.robot.angle_step
        self._operator = Commanding(interval, call, lag, limit, step)

    def decide(self, action: Action) -> Outcome | None:
        """Turn the flippers by one action and simulate one decision; return the outcome, if any.

        An operator's commands replace the action.
        """
        state, begun = self.state, self._sums
        operator, driven = self._operator, True
        # Of rates, the action that counts is the closest one.
        if isinstance(action, tuple):
            self.action, self.rates, steps = closest(action), action, action
        else:
            self.action, self.rates, steps = action, None, self.moves[action]
        # An operator's targets follow from the commands, while the decision runs.
        if operator is None:
            turned = [step * self.robot.angle_step for step in steps]
            self.targets = self._rule.next_targets(self.targets, angles_of(state), turned)
        outcome = self._run()
        if operator is not None:
            self.action, self.commands = operator.end(self.targets)
            driven = float(self.commands[:, 2].mean()) > _DRIVEN
        self._sums = self.world.sums()
        self.flipper_work, self.roll_variation = (
            None if earlier is None or now is None else now - earlier
            for earlier, now in zip(begun, self._sums, strict=True)
        )
        self.state = self.world.state()
        # Without a delay, and at the end of an episode, the perceived state is the current one.
        if self._undelayed or outcome is not None:
            self.delayed_state = self.state
        x = float(self.state.position[0])
        return outcome or self.termination.after_decision(x, driven)

    def _run(self) -> Outcome | None:
        world, termination, operator = self.world, self.termination, self._operator
        done = 0
        path = np.empty((self._events[-1][0] + 1, 3 + len(self.targets)))
        path[0] = self._pose()
        # Advance from event to event; the world stops at the first sample that reaches a limit.
        for sample, event in self._due_events():
            while done < sample:
                poses = world.advance(sample - done, termination.limits)
                begin, done = done + 1, done + len(poses)
                path[begin : done + 1] = poses
                self.poses = path[: done + 1]
                self._moved(poses)
                last = poses[-1, :3].tolist()
                if (outcome := world.ended() or termination.after_sample(*last)) is not None:
                    self._take_samples()
                    return outcome
            if event == _TURN and operator is not None:
                self.targets = operator.command(world, self.targets)
            elif event == _TURN:
                world.command(*self.targets)
            elif event == _SAMPLE:
                self._take_samples()
            elif event == _PERCEIVE and not self._undelayed:
                self.delayed_state = world.state()
        return None

    def _due_events(self) -> Sequence[tuple[int, int]]:
        """Return the events of the next decision, samples of ``sample_every`` included."""
        events, operator = self._events, self._operator
        (samples, _), now = events[-1], self._samples
        if operator is not None:
            commands = [(n, _TURN) for n in range(0, samples, operator.every)]
            events = sorted([*(event for event in events if event[1] != _TURN), *commands])
        if not self._samplings:
            return events
        # Samples lie on a grid of the whole episode, not of the decision.
        intervals = {period for period, _ in self._samplings}
        due = (
            n for n in range(1, samples + 1) if any((now + n) % period == 0 for period in intervals)
        )
        return sorted([*events, *((n, _SAMPLE) for n in due)])

    def _take_samples(self) -> None:
        for interval, call in self._samplings:
            if self._samples % interval == 0:
                call(self.world)

    def _moved(self, poses: FloatArray) -> None:
        self._samples += len(poses)
        for call in self._movements:
            call((self._samples - len(poses) + 1) * SAMPLE_PERIOD, poses)

    def _pose(self) -> tuple[float, ...]:
        """Return the pose at the last decision in the order of ``poses``."""
        state = self.state
        return (*state.position.tolist(), state.pitch, *angles_of(state))

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot for ``load``; it lacks the engine's contact impulses."""
        last = self.poses, self.flipper_work, self.roll_variation
        moving = self.state, self.delayed_state, self.targets, last
        return self.world.save(), self.termination.save(), moving, (self._samples, self._samplings)

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        world, termination, moving, sampling = saved
        self.state, self.delayed_state, self.targets, last = moving
        self.poses, self.flipper_work, self.roll_variation = last
        self._samples, self._samplings = sampling
        self.world.load(world)
        # A snapshot need not contain the sums: their differences begin anew.
        self._sums = self.world.sums()
        self.termination.load(termination)
