"""Controllers as policies, whose answers are checked, and as teachers of a student's policy.

A teacher labels decisions: a label is the target distribution over actions for a student, (3^J,),
from the cost of each action, or from the action that is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    Command,
    Controller,
    CostPolicy,
    FloatArray,
    Perception,
    Policy,
    Simulator,
    StateGroups,
    World,
)
from flipperctl.api.controllers import Rule
from flipperctl.config import Teacher
from flipperctl.config.identity import foreign_plugins
from flipperctl.core.risk import RiskSign
from flipperctl.core.targets import Action, allowed, as_action, closest, of_pairs, of_rule, to_pairs
from flipperctl.env.repeating import require_unmoved
from flipperctl.errors import ConfigError, FlipperctlError
from flipperctl.plugging.checked import require
from flipperctl.plugging.guard import refusal, short_repr
from flipperctl.plugging.randomness import global_states

TEMPERATURE = 0.3
"""Default cost difference that makes an action e times less probable [s]."""


class FunctionPolicy:
    """Decides by a function and has no memory."""

    def __init__(self, rule: Callable[[Perception], int]) -> None:
        self._rule = rule

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; the policy has no memory."""

    def act(self, p: Perception) -> int:
        """Return the action that the function returns."""
        return self._rule(p)


def plugin_policy(controller: Controller, joints: int = 2) -> PluginPolicy:
    """Return the policy that a controller builds, for a robot of J joints."""
    return PluginPolicy(controller, require(controller, "build", controller.build()), joints)


class PluginPolicy:
    """Runs the policy that a controller plugin built.

    An index of pairs drives both sides of a robot with four flippers alike; a rule for four returns
    four rates. Every method raises ``PluginFailedError`` for an answer that the contract does not
    allow, or if the controller draws from global generators.
    """

    def __init__(self, controller: Controller, policy: Policy, joints: int = 2) -> None:
        """Run ``policy``, which ``controller`` built, on a robot of J joints."""
        self._joints = joints
        self._costs_pairs = True
        self._controller, self._foreign = controller, foreign_plugins([controller])
        self._policy: Any = policy
        self.offers_costs = isinstance(policy, CostPolicy)
        """Whether ``costs`` and ``took`` may be called."""
        self.follows = self.offers_costs and callable(getattr(policy, "follow", None))
        """Whether ``follow`` may be called: it can label single decisions of another policy."""
        self.command_period: float | None = getattr(policy, "command_period", None)
        """Time between two calls of ``command`` [s]; None of a policy that chooses actions."""
        self.values_states = self.offers_costs and callable(getattr(policy, "groups", None))
        """Whether ``state_groups`` may be called."""

    def _calling(self, method: str) -> AbstractContextManager[None]:
        """Return a context for a call of ``method``, which may use no global generators."""
        return self._watching(method) if self._foreign else nullcontext()

    @contextmanager
    def _watching(self, method: str) -> Iterator[None]:
        before = global_states()
        yield
        require_unmoved(before, self._foreign, f"in {method}")

    def _refusal(self, method: str, answer: object, allowed: str) -> FlipperctlError:
        owner = None if isinstance(self._policy, Rule) else type(self._policy)
        text = f"returned {short_repr(answer)}; {allowed}"
        return refusal(self._controller, method, text, owner=owner)

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        with self._calling("reset"):
            self._policy.reset(simulator)

    def act(self, p: Perception) -> Action:
        """Return the controller's action."""
        with self._calling("act"):
            answer: object = self._policy.act(p)
            action = as_action(answer)
            # An index, or rates of both pairs, are of pairs; else they are rates of each flipper.
            if action is not None:
                return of_pairs(action, self._joints)
            rates = as_action(answer, self._joints)
        if not isinstance(rates, tuple):
            raise self._refusal("act", answer, allowed())
        return rates

    @property
    def planned(self) -> Any:
        """The ``lookahead.search.Planned`` of the last decision; None of a policy without plans."""
        return getattr(self._policy, "planned", None)

    def command(self, world: World) -> Command:
        """Return what the policy commands within a decision."""
        with self._calling("command"):
            command: Command = self._policy.command(world)
            require(self._controller, "command", command, owner=self._policy)
        return command

    def costs(self, p: Perception) -> FloatArray:
        """Return the policy's cost of each action of J joints, (3^J,) [s].

        Of a policy of pairs, what turns both sides alike has its finite cost, all else infinity.
        """
        with self._calling("costs"):
            answer: object = self._policy.costs(p)
            costs = np.asarray(answer, np.float64)
        self._costs_pairs = costs.shape == (len(ACTIONS),)
        fits = self._costs_pairs or costs.shape == (3**self._joints,)
        if not fits or not np.isfinite(costs).all():
            raise self._refusal("costs", answer, f"{len(ACTIONS)} finite costs are allowed")
        if not self._costs_pairs:
            return costs
        widened = np.full(3**self._joints, np.inf)
        for action, cost in enumerate(costs):
            widened[closest(of_pairs(action, self._joints))] = cost
        return widened

    def took(self, action: int) -> None:
        """Tell the policy which action was taken after its ``costs``."""
        with self._calling("took"):
            self._policy.took(self._its(action))

    def follow(self, p: Perception, action: int) -> None:
        """Tell the policy what another one perceived and did."""
        with self._calling("follow"):
            self._policy.follow(p, self._its(action))

    def _its(self, action: int) -> int:
        """Return an action of J joints as the policy's own, of pairs the closest one."""
        return to_pairs(action, self._joints) if self._costs_pairs else action

    def state_groups(self, rng: np.random.Generator) -> StateGroups:
        """Return groups of states of the episode's ground with finite values of their actions."""
        with self._calling("groups"):
            groups: StateGroups = self._policy.groups(rng)
            require(self._controller, "groups", groups, owner=self._policy)
        return groups


def from_costs(costs: FloatArray, temperature: float = TEMPERATURE) -> NDArray[np.float32]:
    """Return softmax(-costs / temperature), (3^J,).

    ``costs``: cost of each action, (3^J,), one of them finite [s]; ``temperature`` in seconds.
    """
    # Differences to the least cost keep the exponentials finite.
    weights = np.exp((costs.min() - costs) / temperature)
    return np.asarray(weights / weights.sum(), np.float32)


def from_action(action: Action, joints: int = 2) -> NDArray[np.float32]:
    """Return the distribution that is 1 at the turns closest to ``action``, else 0, (3^J,)."""
    label = no_label(joints)
    label[closest(action)] = 1.0
    return label


def no_label(joints: int = 2) -> NDArray[np.float32]:
    """Return the zeros of a state without a label, (3^J,)."""
    return np.zeros(3**joints, np.float32)


class Labeller:
    """Asks a policy for actions and labels them, by their costs if the policy offers them."""

    def __init__(self, policy: Policy, temperature: float = TEMPERATURE) -> None:
        """``temperature``: difference of costs [s]; see ``from_costs``."""
        self._policy: Any = policy
        self._temperature = temperature
        self._by_costs = isinstance(policy, PluginPolicy) and policy.offers_costs

    def choose(self, p: Perception) -> tuple[Action, NDArray[np.float32]]:
        """Return the policy's action, the cheapest if it offers costs, and the label, (3^J,)."""
        if not self._by_costs:
            action = self._policy.act(p)
            return action, from_action(action, len(p.layout.joints))
        costs: FloatArray = self._policy.costs(p)
        return int(costs.argmin()), from_costs(costs, self._temperature)

    def took(self, action: int) -> None:
        """Tell a policy that offers costs which action was taken after ``choose``."""
        if self._by_costs:
            self._policy.took(action)


class DemonstratingPolicy:
    """Acts as its policy; labels each decision by action costs, or by the action without costs."""

    groups = None

    def __init__(self, policy: Policy) -> None:
        self._policy: Any = policy
        self._labeller = Labeller(policy)
        self.label = from_action(0)
        """The distribution over actions at the last decision, (3^J,)."""
        self.command_period: float | None = getattr(policy, "command_period", None)
        self.command = getattr(policy, "command", None)
        self.risk_sign: RiskSign | None = getattr(policy, "risk_sign", None)
        """When the policy's risk is a warning; None if it knows none."""

    @property
    def risk(self) -> float | None:
        """Risk at the policy's last decision; None if it knows none."""
        return None if self.risk_sign is None else self._policy.risk

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> Action:
        """Return the policy's action, the cheapest if it offers costs; store the label."""
        action, self.label = self._labeller.choose(p)
        self._labeller.took(closest(action))
        return action


class DaggerPolicy:
    """Lets the student or the teacher act for an episode; the teacher labels both (DAgger).

    Ross, Gordon and Bagnell 2011, with whole episodes instead of single decisions mixed.
    """

    def __init__(
        self,
        student: Policy,
        teacher: PluginPolicy,
        settings: Teacher,
        student_learns: Callable[[], bool],
        rng: np.random.Generator,
    ) -> None:
        """``student_learns`` is called before each episode; while it is False, the teacher acts.

        ``rng`` chooses who acts, and the random actions of the teacher's episodes.
        """
        self._student, self._teacher, self._settings = student, teacher, settings
        self._labeller = Labeller(teacher, settings.temperature)
        if settings.label_share < 1 and not teacher.follows:
            raise ConfigError(
                f"teacher.label_share: {settings.label_share:g} needs a teacher that follows "
                "decisions which it does not label, such as mpc; 1 is allowed"
            )
        self._student_learns, self._rng = student_learns, rng
        self._student_acts = False
        self.explored = False
        """Whether the last action was random."""
        self._simulator: Simulator | None = None
        self.label = from_action(0)
        """The teacher's distribution over actions at the last decision, (3^J,); zeros: none."""
        self.groups: StateGroups | None = None
        """States of the episode's ground with their values, of a teacher that knows them."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode of both policies and choose which one acts."""
        self._student.reset(simulator)
        self._teacher.reset(simulator)
        # A privileged teacher sees the true state of an episode that it repeats from its start.
        if self._settings.privileged:
            simulator.restart()  # the policies may have simulated in it
            self._simulator = simulator
        if self._teacher.values_states:
            self.groups = self._teacher.state_groups(self._rng)
        # Until the student has learnt from something, the teacher acts.
        share = self._settings.student_share if self._student_learns() else 0.0
        self._student_acts = self._rng.random() < share

    def act(self, p: Perception) -> int:
        """Return the acting policy's action; store the teacher's label."""
        simulator, share = self._simulator, self._settings.label_share
        joints = len(p.layout.joints)
        seen = p if simulator is None else simulator.perceive_exactly()
        # Some decisions of the student get no label; the teacher only follows them.
        if self._student_acts and share < 1 and self._rng.random() >= share:
            action, self.label = self._student_action(p), no_label(joints)
            self._teacher.follow(seen, action)
        else:
            # The teacher labels this decision, whoever acts.
            choice, self.label = self._labeller.choose(seen)
            acts = self._student_acts
            action = self._student_action(p) if acts else self._varied(closest(choice), joints)
            self._labeller.took(action)
        if simulator is not None:
            simulator.step(of_rule(action, joints))  # repeats the episode bit for bit
        return action

    def _student_action(self, p: Perception) -> int:
        action = self._student.act(p)
        assert isinstance(action, int)  # of our own learners
        self.explored = getattr(self._student, "explored", False)
        return action

    def _varied(self, choice: int, joints: int) -> int:
        """Return the teacher's ``choice``, or a random action."""
        self.explored = self._rng.random() < self._settings.random
        return int(self._rng.integers(3**joints)) if self.explored else choice
