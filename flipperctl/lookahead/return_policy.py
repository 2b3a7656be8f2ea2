"""The policy of ``mpc`` with a value: it plans for the largest return on the perceived ground.

In: perceptions alone. Out: actions. The finish is not perceived; it is presumed one run-out past
the last edge that is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np

from flipperctl.api import (
    FloatArray,
    Perception,
    Profile,
    RewardTerm,
    Robot,
    Shaping,
    Simulator,
)
from flipperctl.config import Episode
from flipperctl.lookahead.heights import Ground
from flipperctl.lookahead.history import History
from flipperctl.lookahead.learned import LearnedValue
from flipperctl.lookahead.model import Model
from flipperctl.lookahead.mpc_settings import MpcSettings
from flipperctl.lookahead.policy import MpcPolicy
from flipperctl.lookahead.returns import Returns
from flipperctl.lookahead.search import Plan, Search
from flipperctl.reward_sum import RewardSum

_EPISODE = Episode()
"""A robot does not know its episode's own settings; plans are made for the defaults."""
_EDGE = 0.03
"""Height difference to the ground ahead that counts as an edge [m]."""
_PATIENCE, _WIDEST = 3, 4
"""Decisions of standing after which the search widens again, and its largest multiple [-]."""
_STANDS_STILL = 2
"""Decisions of standing from which plans hurry, with ``hurry_below`` [-]."""
_SLIPPERY = 0.8
"""Factor of the assumed friction after as many decisions of standing [-]."""


class ReturnPolicy(MpcPolicy):
    """Plans for the largest return; remembers map, targets, plan, and its last pitches."""

    def __init__(self, settings: MpcSettings, learned: LearnedValue) -> None:
        """Plan with the value and its rewards, unless the ``settings`` have some.

        The shaping is that of the value's training in any case, since only that cancels out: the
        value of a state is the smaller by its potential.

        Raises:
            ConfigError: a reward term needs what predictions lack.
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
        """Return whether the robot got no farther than before; one that rocks in place stands."""
        self._way += motion[0]
        if self._way < self._farthest + self._least():
            return True
        self._farthest = self._way
        return False

    def _assumed_friction(self) -> float:
        """Return less friction, the longer a robot stands for which the plan was to move on."""
        return self._settings.assumed_friction * _SLIPPERY ** (self._standing // _PATIENCE)

    def _presumed_finish(self, line: FloatArray, robot: Robot) -> tuple[float, float]:
        """Return x of the finish and the largest height there, in frame L [m]."""
        self._line, level = line, float(line[-1, 1])
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
        objective = Returns(
            rewards=self._rewards,
            horizon=lambda nodes: learned.value(ground.observations(nodes.places, nodes.states)),
            gamma=learned.gamma,
            profile=Profile(self._line),
            robot=robot,
            root=self._history.node(root, np.array(model.chassis(root))),
            standing=self._standing,
            patience=_EPISODE.stuck_decisions(robot.decision_period),
            averaging=settings.averaging,
        )
        width = settings.beam * min(_WIDEST, 1 + self._standing // _PATIENCE)
        search = Search(
            robot,
            objective,
            width=width,
            depth=settings.horizon,
            beam_per_action=max(1, settings.of_each),
        )
        plan = search.run(model, root, self._former, deadline)
        self.simulated = plan.simulated
        return plan


def _speed(plan: Plan, robot: Robot) -> float:
    """Return the mean speed of a plan along x [m/s]; 0 for one without decisions."""
    lasts = len(plan.actions) * robot.decision_period
    return float(plan.states[-1, 0] - plan.states[0, 0]) / lasts if lasts else 0.0


def _paid(
    own: Mapping[str, RewardTerm], given: Mapping[str, RewardTerm] | None
) -> Mapping[str, RewardTerm]:
    """Return the terms that plans are paid by: the given ones with the shaping of the value's."""
    if given is None:
        return own
    return {
        **{name: term for name, term in given.items() if not isinstance(term, Shaping)},
        **{f"value.{name}": term for name, term in own.items() if isinstance(term, Shaping)},
    }
