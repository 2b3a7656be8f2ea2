"""The policy of ``mpc``: it perceives, plans, and takes the first action of its plan.

In: perceptions alone. Out: actions. The policy simulates a nominal robot on the perceived ground.
Without a learned value it plans for the least hand-set cost, in seconds, and with one for the
largest return. The finish is unknown; it is assumed ``run_out`` past the last seen edge.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    FloatArray,
    LearnedValue,
    Perception,
    Profile,
    RewardTerm,
    Robot,
    Shaping,
    Simulator,
)
from flipperctl.config import Episode
from flipperctl.config.reward_sum import RewardSum
from flipperctl.core.ground_map import GroundMap
from flipperctl.lookahead.model import (
    TARGETS,
    TURNS,
    Branch,
    Ground,
    Model,
    compile_now,
    next_targets,
    nominal,
)
from flipperctl.lookahead.search import (
    HOLD,
    History,
    Plan,
    Planned,
    Returns,
    Scores,
    Search,
    none_yet,
)
from flipperctl.lookahead.settings import MpcSettings
from flipperctl.sim.ground import kept_points

HURRY = 5.0
"""Divisor of the cost weight of pitch variation in a hurry [-]."""


@dataclass(frozen=True, kw_only=True)
class HandSetCost:
    """What the plans of M nodes have cost so far by the hand-set cost, in seconds."""

    settings: MpcSettings
    robot: Robot
    begin: float  # x of the chassis centre at the root [m]
    hurry: int = 0
    """How often the weights of pitch variation and final pitch are divided by ``HURRY`` [-]."""
    poses: bool = False
    depth: int = 0  # number of decisions from the root
    variation: FloatArray = field(default_factory=none_yet)  # pitch variation, (M,) [rad]
    paid: FloatArray = field(default_factory=none_yet)  # cost of postures and turns, (M,) [s]
    steep: FloatArray = field(default_factory=none_yet)  # largest absolute pitch, (M,) [rad]

    def take(self, rows: NDArray[np.int64]) -> HandSetCost:
        """Return the account of some of the nodes."""
        return replace(
            self,
            variation=self.variation[rows],
            paid=self.paid[rows],
            steep=self.steep[rows],
        )

    def extend(
        self, parent: NDArray[np.int64], action: NDArray[np.int64], branch: Branch
    ) -> Scores:
        """Return the scores of plans that are one decision longer."""
        weights, robot, states = self.settings, self.robot, branch.states
        # What has been paid for good: pitch variation, postures and turns
        variation = self.variation[parent] + branch.pitch_variation
        step = (
            weights.flippers * np.abs(states[:, TARGETS:]).sum(axis=1)
            + weights.lean * np.abs(states[:, 2])
            + weights.turn * np.abs(TURNS[action]).sum(axis=1)
        )
        paid = self.paid[parent] + step
        steep = np.maximum(self.steep[parent], branch.steepest)
        # Time that is lost against driving at full speed
        distance = branch.places[:, 0] - self.begin
        lost = robot.decision_period * (self.depth + 1) - distance / robot.track_speed
        lost = np.maximum(lost, 0.0)  # otherwise plans would push themselves along by flippers
        # What the plan's end adds; in a hurry, smoothness counts less.
        calm = HURRY**-self.hurry
        final = (
            lost
            + weights.standstill * np.maximum(0.0, lost - weights.standstill_from)
            + calm * weights.pitch * np.abs(states[:, 2])
            + weights.steep * np.maximum(0.0, steep - weights.steep_from)
        )
        weight = calm * weights.swing
        return Scores(
            cost=paid + final + weight * variation,
            hurried=paid + final + weight / HURRY * variation,
            ended=np.zeros(len(lost), np.bool_),
            lost_time=lost,
            account=replace(
                self, depth=self.depth + 1, variation=variation, paid=paid, steep=steep
            ),
        )


NO_PLAN = 1000.0
"""Cost of an action that begins no plan of the search [s]."""
STANDS = 0.25
"""Share of the way of a decision at full speed below which the robot counts as standing still
[-]."""
_PATIENCE = 3  # number of decisions without progress after which the search widens again [-]
_MOST_HURRY = 4
"""Largest multiple of the wide search's width, and of reductions of its cost weights [-]."""
_CLOSE = 0.05  # largest gap or overlap at which robot and sensed ground count as touching [m]
_MAX_ERROR = np.array([0.04, 0.04, 0.05])
"""Largest errors of x, z [m] and pitch [rad] at which predicted velocities are reused."""


class MpcPolicy:
    """Plans at each decision; remembers the map, the flippers' targets and the last plan."""

    def __init__(self, settings: MpcSettings) -> None:
        self._settings = settings
        self._robot = Robot()
        self._forget()

    def _forget(self) -> None:
        self._map = GroundMap(self._settings.memory, kept_points)
        self._begun = False
        self._targets = self._angles = 0.0, 0.0
        self._plan: Plan | None = None  # of the last decision
        self._former: tuple[int, ...] = ()
        self._motion = 0.0, 0.0  # in the last decision [m]
        self._hurried = False
        self._standing = 0
        self.simulated = 0
        """Decisions simulated for the last action, by all of its searches [-]."""

    def reset(self, simulator: Simulator) -> None:
        """Forget the last episode; the simulator is not used."""
        self._forget()
        compile_now()  # not at the first decision, which may be timed

    def act(self, p: Perception) -> int:
        """Return the first action of the best plan from here."""
        action = self._plan_from(p).actions[0]
        self.took(action)
        return action

    @property
    def planned(self) -> Planned | None:
        """The plan of the last decision, its first action included; None without one."""
        if self._plan is None:
            return None
        path = self._plan.states[:, :2]
        return Planned(self._plan.actions, path - path[0])

    def costs(self, p: Perception) -> FloatArray:
        """Return the cost of the best plan that begins with each action, (9,) [s]."""
        costs = self._plan_from(p).costs
        return np.where(np.isfinite(costs), costs, NO_PLAN)

    def took(self, action: int) -> None:
        """Turn the remembered targets; keep the rest of the plan if the action is its first."""
        assert self._plan is not None  # costs() or act() made it
        self._former = self._plan.actions[1:] if action == self._plan.actions[0] else ()
        self._turn(action)

    def follow(self, p: Perception, action: int) -> None:
        """Remember a decision that another policy made, without a plan of its own."""
        self._measure(p)
        self._perceive(p, self._robot)
        self._plan, self._former = None, ()
        self._turn(action)

    def _turn(self, action: int) -> None:
        self._targets = next_targets(self._robot, self._targets, self._angles, action)

    def _measure(self, p: Perception) -> None:
        """Remember robot and angles; an episode begins with the angles as targets."""
        self._robot = nominal(p.robot)
        self._angles = p.front, p.rear
        if not self._begun:
            self._targets, self._begun = self._angles, True

    def _plan_from(self, p: Perception) -> Plan:
        """Search from here; remember the plan and the measured angles."""
        settings = self._settings
        begun = time.perf_counter()
        deadline = begun + settings.time_limit if settings.time_limit else math.inf
        self._measure(p)
        model, root = self._scene(p, self._robot)
        self._plan = self._search(model, root, self._robot, deadline)
        return self._plan

    def _search(self, model: Model, root: FloatArray, robot: Robot, deadline: float) -> Plan:
        """Search with the normal cost weights; if that plan gets stuck, search wider in a hurry.

        The longer the robot stands still, the wider the search and the smaller the weight of
        pitch variation.
        """
        settings, former = self._settings, self._former
        hurry = min(_MOST_HURRY, 1 + self._standing // _PATIENCE)
        depth, per_action = settings.horizon, settings.of_each
        calm = HandSetCost(settings=settings, robot=robot, begin=model.chassis(root)[0])
        plan, self.simulated = None, 0
        # Calmly first, unless the robot stands or hurried before
        if not self._hurried and hurry == 1:
            search = Search(robot, settings.beam, depth, per_action)
            plan = search.run(model, root, calm, former, deadline)
            self.simulated = plan.simulated
            stuck = plan.lost_time > settings.stuck_from or len(plan.actions) < settings.horizon
            self._hurried = stuck and time.perf_counter() < deadline
        # Wider and in a hurry, once the calm plan gets stuck
        if plan is None or self._hurried:
            width = round(settings.wider * settings.beam * hurry)
            search = Search(robot, width, depth, per_action)
            plan = search.run(model, root, replace(calm, hurry=hurry), former, deadline)
            self.simulated += plan.simulated
            self._hurried = plan.lost_time > settings.stuck_from / 2
        return plan

    def _scene(self, p: Perception, robot: Robot) -> tuple[Model, FloatArray]:
        """Return the nominal robot's simulation on the perceived ground, and its present state."""
        settings = self._settings
        line, motion = self._perceive(p, robot)
        finish, top = self._presumed_finish(line, robot)
        model = Model(
            line,
            robot,
            friction=self._assumed_friction() if p.friction is None else p.friction,
            step=settings.step,
            iterations=settings.iterations,
            overturn=settings.overturn,
            finish=finish,
            top=top,
        )
        # No velocity is perceived: it is what the last plan predicted if the motion came true, else
        # full speed along the chassis.
        speed = robot.track_speed
        pose = (0.0, _touching(line, p, robot), p.pitch)
        rates = (speed * math.cos(p.pitch), speed * math.sin(p.pitch), 0.0)
        root = model.state(pose, (p.front, p.rear), rates)
        if self._plan is not None:
            before, expected = self._plan.states[:2]
            moved = expected[:3] - (before[0], before[1], 0.0)
            if (np.abs(moved - (*motion, p.pitch)) < _MAX_ERROR).all():
                root[3:6] = expected[3:6]
        root[TARGETS:] = next_targets(robot, self._targets, (p.front, p.rear), HOLD)
        # The search begins at the state in which the flippers will turn.
        if settings.latency:
            root = model.expand(root[None], root[None, TARGETS:], settings.latency).states[0]
        return model, root

    def _assumed_friction(self) -> float:
        """Return the friction in the prediction, as it is not known [-]."""
        return self._settings.assumed_friction

    def _presumed_finish(self, line: FloatArray, robot: Robot) -> tuple[float, float]:
        """Return x of the finish and the largest height there, in frame L [m]; none is presumed."""
        return math.inf, math.inf

    def _perceive(self, p: Perception, robot: Robot) -> tuple[FloatArray, tuple[float, float]]:
        """Return the ground in frame L, (V, 2) [m], and the motion since the last decision [m]."""
        # The motion that the last plan predicted is the guess for aligning the scans.
        guess = self._motion
        if self._plan is not None:
            before, expected = self._plan.states[:2]
            guess = float(expected[0] - before[0]), float(expected[1] - before[1])
        motion = self._motion = self._map.add(p.points, guess)
        self._standing = self._standing + 1 if self._stood(motion) else 0
        line = self._map.line()
        if not len(line):  # nothing was perceived: assume level ground under the tracks
            line = np.array([[0.0, -robot.track_radius]])
        return line, motion

    def _stood(self, motion: tuple[float, float]) -> bool:
        """Return whether the robot stood still in its last decision, from its ``motion`` [m]."""
        return math.hypot(*motion) < self._least()

    def _least(self) -> float:
        """Return the way of a decision below which the robot stands [m]."""
        return STANDS * self._robot.track_speed * self._robot.decision_period


def _touching(line: FloatArray, p: Perception, robot: Robot) -> float:
    """Return the height of the chassis centre in frame L at which the robot touches the ground [m].

    It is 0 if the ground is farther away than noise and bias can explain.
    """
    hinge, axle = robot.hinge_offset, robot.flipper_axle
    front, rear = p.pitch + p.front, p.pitch - p.rear
    here = np.array([math.cos(p.pitch), math.sin(p.pitch)])
    segments = (
        (-hinge * here, hinge * here),
        (hinge * here, hinge * here + (axle * math.cos(front), axle * math.sin(front))),
        (-hinge * here, -hinge * here - (axle * math.cos(rear), axle * math.sin(rear))),
    )
    along = np.linspace(0.0, 1.0, 12)[:, None]
    axes = [a + along * (b - a) for a, b in segments]
    at = np.concatenate(axes)  # (36, 2) [m]
    # How high the centre of a round end must be at each point of an axis to clear the ground
    low, high = at[:, 0].min() - 0.2, at[:, 0].max() + 0.2
    x = np.union1d(np.arange(low, high, 0.01), line[(line[:, 0] > low) & (line[:, 0] < high), 0])
    z = np.interp(x, line[:, 0], line[:, 1])
    away = at[:, :1] - x
    reach = robot.track_radius**2 - away**2
    needed = np.where(reach > 0, z + np.sqrt(np.maximum(reach, 0.0)), -np.inf).max(axis=1)
    lift = float((needed - at[:, 1]).max())
    return lift if abs(lift) < _CLOSE else 0.0


_EPISODE = Episode()
"""A robot does not know its episode's own settings; plans are made for the defaults."""
_EDGE = 0.03  # height difference to the ground ahead that counts as an edge [m]
_AVERAGING = 0.5  # share of the estimates at smaller depths in the return of a plan [-]
_LONG, _WIDEST = 3, 4
"""Decisions of standing after which the search widens again, and its largest multiple [-]."""
_STANDS_STILL = 2  # decisions of standing from which plans hurry, with ``hurry_below`` [-]
_SLIPPERY = 0.8  # factor of the assumed friction after as many decisions of standing [-]


class ReturnPolicy(MpcPolicy):
    """Plans for the largest return; remembers map, targets, plan, and its last pitches."""

    def __init__(self, settings: MpcSettings, learned: LearnedValue) -> None:
        """Plan with the value and its rewards, unless the ``settings`` have some.

        The shaping always comes from the value's training. Training with it makes the value of a
        state smaller by its potential, and only the same shaping cancels that out.
        """
        super().__init__(settings)
        self._learned = learned
        self._rewards = RewardSum(_paid(learned.rewards, settings.rewards))
        self._rewards.require_predictable("controller.rewards")

    def reset(self, simulator: Simulator) -> None:
        """Forget the last episode; the simulator is not used."""
        super().reset(simulator)
        self._history = History()
        self._way = self._farthest = 0.0  # from the start, by its own odometry [m]

    def took(self, action: int) -> None:
        """Remember the turns that were taken."""
        super().took(action)
        self._history.took(action, self._robot.decision_period)

    def follow(self, p: Perception, action: int) -> None:
        """Remember a decision that another policy made, without a plan of its own."""
        self._history.saw(p.pitch)
        super().follow(p, action)
        self._history.took(action, self._robot.decision_period)

    def _plan_from(self, p: Perception) -> Plan:
        self._history.saw(p.pitch)
        return super()._plan_from(p)

    def _stood(self, motion: tuple[float, float]) -> bool:
        """Return whether the robot got no farther than before; rocking in place is standing."""
        self._way += motion[0]
        if self._way < self._farthest + self._least():
            return True
        self._farthest = self._way
        return False

    def _assumed_friction(self) -> float:
        """Return less friction, the longer a robot stands for which the plan was to move on."""
        return self._settings.assumed_friction * _SLIPPERY ** (self._standing // _LONG)

    def _presumed_finish(self, line: FloatArray, robot: Robot) -> tuple[float, float]:
        """Return x of the finish and the largest height there, in frame L [m]."""
        self._line, level = line, float(line[-1, 1])
        # The last point that is off the level of the far end is taken for the last edge.
        uneven = np.flatnonzero(np.abs(line[:, 1] - level) > _EDGE)
        edge = float(line[min(uneven[-1] + 1, len(line) - 1), 0]) if len(uneven) else -math.inf
        return edge + _EPISODE.run_out, level + robot.track_radius + _EPISODE.clearance

    def _search(self, model: Model, root: FloatArray, robot: Robot, deadline: float) -> Plan:
        """Search for the largest return, or with the hand-set cost where the robot shall hurry.

        A learned value may rate a robot that waits above one that rocks on, on ground that it does
        not know well.
        """
        least = self._settings.hurry_below * robot.track_speed
        if not least:
            return self._search_return(model, root, robot, deadline)
        simulated = 0
        # A return decides while its plan is fast enough.
        if self._standing < _STANDS_STILL:
            plan = self._search_return(model, root, robot, deadline)
            if _speed(plan, robot) >= least or time.perf_counter() > deadline:
                return plan
            simulated = plan.simulated
        else:
            self._hurried = True
        plan = super()._search(model, root, robot, deadline)
        self.simulated += simulated
        return plan

    def _search_return(self, model: Model, root: FloatArray, robot: Robot, deadline: float) -> Plan:
        """Search for the largest return, the wider the longer the robot has stood."""
        settings, learned = self._settings, self._learned
        ground = Ground(self._line, learned.layout)
        place = np.array(model.chassis(root))
        account = Returns(
            rewards=self._rewards,
            horizon=lambda nodes: learned.value(ground.observations(nodes.places, nodes.states)),
            gamma=learned.gamma,
            profile=Profile(self._line),
            robot=robot,
            nodes=self._history.node(root, place),
            begin=place[0],
            standing=self._standing,
            patience=_EPISODE.stuck_decisions(robot.decision_period),
            averaging=_AVERAGING,
        )
        # A robot that stands searches more widely, to get free.
        width = settings.beam * min(_WIDEST, 1 + self._standing // _LONG)
        search = Search(robot, width, settings.horizon, max(1, settings.of_each))
        plan = search.run(model, root, account, self._former, deadline)
        self.simulated = plan.simulated
        return plan


def _speed(plan: Plan, robot: Robot) -> float:
    """Return the mean speed of a plan along x [m/s]; 0 for one without decisions."""
    lasts = len(plan.actions) * robot.decision_period
    return float(plan.states[-1, 0] - plan.states[0, 0]) / lasts if lasts else 0.0


def _paid(
    trained: Mapping[str, RewardTerm], configured: Mapping[str, RewardTerm] | None
) -> Mapping[str, RewardTerm]:
    """Return the terms that plans are paid by; the shaping is the one of the value's training."""
    if configured is None:
        return trained
    terms = {name: term for name, term in configured.items() if not isinstance(term, Shaping)}
    shaping = {f"value.{name}": t for name, t in trained.items() if isinstance(t, Shaping)}
    return terms | shaping
