"""The policy of ``value_iteration``: it knows the ground, and the value of every state on it.

In: the simulator of an episode. Out: the actions of the largest return, their values, and groups of
states for a student.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flipperctl.api import ACTIONS, FloatArray, Perception, RewardTerm, Simulator, StateGroups
from flipperctl.config import Episode
from flipperctl.core.targets import TargetRule
from flipperctl.lookahead.contacts import MOST_EXACT
from flipperctl.lookahead.goal import highest_at_finish
from flipperctl.lookahead.graph import Course, Graph
from flipperctl.lookahead.groups import sample_groups, with_stops
from flipperctl.lookahead.history import History
from flipperctl.lookahead.model import TARGETS, Model, compile_now
from flipperctl.lookahead.nodes import Nodes
from flipperctl.lookahead.policy import nominal
from flipperctl.lookahead.returns import Returns
from flipperctl.lookahead.search import Search
from flipperctl.lookahead.value_iteration_settings import ValueIterationSettings
from flipperctl.reward_sum import RewardSum

_EPISODE = Episode()
"""A ``Simulator`` does not tell its episode's own settings; values are those of the defaults."""


class OraclePolicy:
    """Explores the ground of an episode, then takes the actions of the largest value."""

    def __init__(self, settings: ValueIterationSettings, rewards: Mapping[str, RewardTerm]) -> None:
        """Prepare for any episode.

        Raises:
            ConfigError: a reward term needs what predictions lack.
        """
        self._settings, self._rewards = settings, RewardSum(rewards)
        self._rewards.require_predictable("rewards")

    def reset(self, simulator: Simulator) -> None:
        """Explore the ground."""
        compile_now()
        settings = self._settings
        p = simulator.perceive_exactly()
        simulator.restart()
        self._simulator, self._layout = simulator, p.layout
        robot = self._robot = nominal(p.robot)
        profile, state = simulator.profile, simulator.state
        top = highest_at_finish(profile, robot, simulator.finish)
        self._model = Model(
            profile.points,
            robot,
            friction=settings.friction if p.friction is None else p.friction,
            step=settings.step,
            iterations=settings.iterations,
            overturn=_EPISODE.overturn,
            finish=simulator.finish,
            top=top,
            contacts=MOST_EXACT,
        )
        self._patience = _EPISODE.stuck_decisions(robot.decision_period)
        course = Course(
            profile,
            start=float(state.position[0]),
            finish=simulator.finish,
            patience=self._patience,
        )
        self._graph = Graph(course, self._model, robot, self._rewards, settings.gamma)
        simulator.report_result(unexplored=self._graph.unexplored)
        self._targets = state.front, state.rear
        self._history = History()
        self._pending: int | None = None
        self._decided_at = state.time

    def act(self, p: Perception) -> int:
        """Return the action of the largest value in the true state."""
        action = int(self.costs(p).argmin())
        self.took(action)
        return action

    def costs(self, p: Perception) -> FloatArray:
        """Return the negative value of each action in the true state, (9,) [-]."""
        self._catch_up()
        settings, robot, root = self._settings, self._robot, self._here()
        objective = Returns(
            rewards=self._rewards,
            horizon=self._horizon,
            gamma=settings.gamma,
            profile=self._simulator.profile,
            robot=robot,
            root=root,
            standing=0,
            patience=self._patience,
        )
        search = Search(
            robot,
            objective,
            width=settings.beam,
            depth=settings.horizon,
            beam_per_action=1,
        )
        costs = search.run(self._model, root.states[0]).costs
        costs = -with_stops(-costs[None])[0]
        return np.asarray(np.where(np.isfinite(costs), costs, costs[np.isfinite(costs)].max()))

    def took(self, action: int) -> None:
        """Remember the action that was taken."""
        robot, state = self._robot, self._simulator.state
        turns = [turn * robot.angle_step for turn in ACTIONS[action]]
        rule = TargetRule(robot.angle_step, robot.angle_limit)
        self._targets = rule.next_targets(self._targets, (state.front, state.rear), turns)
        self._history.took(action, robot.decision_period)
        self._pending, self._decided_at = action, state.time

    def _catch_up(self) -> None:
        """Repeat the last action in the simulator, unless whoever asked for it has done so."""
        if self._pending is not None and self._simulator.state.time == self._decided_at:
            self._simulator.step(self._pending)
        self._pending = None

    def groups(self, rng: np.random.Generator) -> StateGroups:
        """Return groups of states of the episode's ground with the values of their actions."""
        settings, robot = self._settings, self._robot
        return sample_groups(
            self._graph,
            self._simulator.profile.extended(3.0, 3.0),
            self._layout,
            rng,
            count=settings.groups,
            off_path=settings.off_path,
            unseen=settings.unseen,
            way=robot.track_speed * robot.decision_period,
        )

    def _horizon(self, nodes: Nodes) -> FloatArray:
        """Return the values of the states that represent ``nodes``, (M,) [-]."""
        found = self._graph.lookup(nodes)
        best = self._graph.best
        return np.asarray(np.where(found < 0, best.min(), best[found]))

    def _here(self) -> Nodes:
        """Return the true state as a node."""
        state, robot = self._simulator.state, self._robot
        self._history.saw(state.pitch)
        x, z = state.position
        found = self._model.state(
            (float(x), float(z), state.pitch),
            (state.front, state.rear),
            (float(state.velocity[0]), float(state.velocity[1]), state.pitch_rate),
        )
        rule = TargetRule(robot.angle_step, robot.angle_limit)
        found[TARGETS:] = rule.next_targets(self._targets, (state.front, state.rear), (0.0, 0.0))
        return self._history.node(found, state.position)
