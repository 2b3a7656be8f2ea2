"""``mpc``, ``planner``, ``rollouts`` and ``value_iteration``, which plan in simulation.

Importing this package registers them; building their policies imports numba.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Self

from pydantic import PrivateAttr

from flipperctl.api import (
    Controller,
    LearnedValue,
    Policy,
    RewardTerm,
    Settings,
    Task,
    ValuedPolicy,
    controller,
)
from flipperctl.config import PAPER_REWARDS
from flipperctl.config.resolver import create
from flipperctl.errors import ConfigError
from flipperctl.lookahead.settings import (
    MpcSettings,
    PlannerSettings,
    RolloutSettings,
    ValueIterationSettings,
)

__all__ = ["Mpc", "Planner", "Rollouts", "ValueIteration"]


@controller("mpc")
class Mpc(MpcSettings, Controller):
    """Model predictive control: plan on the perceived ground, take one action, plan again.

    At each decision a beam search simulates a nominal robot on the perceived ground and takes the
    first action of the best plan. With ``value``, by default the shipped one, plans have the
    largest return of reward terms, and end with the values of a trained policy. Without it, they
    have the least hand-set cost: lost time plus, weighted in seconds, pitch variation, postures and
    the pitch at the horizon. The controller needs no training of its own and runs in real time on
    one core.
    """

    baselines: ClassVar[tuple[str, ...]] = ("geometric", "level")
    reference_settings: ClassVar[Mapping[str, Any]] = {"value": ""}

    _learned: LearnedValue | None = PrivateAttr(None)

    def ending_with(self, learned: LearnedValue) -> Mpc:
        """Return these settings with the values that ``value`` names."""
        settings = self.model_copy()
        settings._learned = learned
        return settings

    def uses(self) -> Mapping[str, str]:
        """Return ``value``, if it names a policy."""
        return {"value": self.value} if self.value else {}

    def using(self, task: Task) -> Mpc:
        """Return these settings with the values that ``value`` names.

        With ``fallback`` and a robot for which they were not trained, with the hand-set cost.
        """
        if not self.value:
            return self
        learned = task.value("value")
        if self.fallback and any(_misfits(learned, task)):
            return self.model_copy(update={"value": ""})
        return self.ending_with(learned)

    def remarks(self, task: Task) -> Iterator[str]:
        """Yield a sentence if ``using`` falls back to the hand-set cost."""
        if self.value and self.fallback and (misfits := [*_misfits(task.value("value"), task)]):
            yield (
                f"{task.path}.value: {self.value} was not trained for {', '.join(misfits)}; plans "
                f"have the hand-set cost instead; {task.path}.value={self.value} keeps the values"
            )

    def build(self) -> Policy:
        """Return a policy that plans with these settings.

        Raises:
            ConfigError: ``value`` names values that ``using`` has not read, there are
                ``rewards`` without it, or a term needs what predictions lack.
        """
        from flipperctl.lookahead.mpc import MpcPolicy, ReturnPolicy

        # Values of what follows a plan go with rewards; the hand-set cost has neither.
        if self._learned is not None:
            return ReturnPolicy(self, self._learned)
        if self.value:
            raise ConfigError(
                f"controller.value={self.value}: the file of the values was not read; "
                "flipperctl.load and the commands read it, and value='' needs none"
            )
        if self.rewards is not None:
            raise ConfigError(
                "controller.rewards: plans are paid by rewards only with values of what follows "
                "them; set controller.value to a run that was trained with these rewards"
            )
        return MpcPolicy(self)


def _misfits(learned: LearnedValue, task: Task) -> Iterator[str]:
    return learned.misfits(task.config.robot, task.config.perception.layout)


class _Improving(Settings):
    """Settings of a controller that begins with the policy that ``policy`` names, if any."""

    policy: str
    baselines: ClassVar[tuple[str, ...]] = ("geometric", "level")

    _trained: ValuedPolicy | None = PrivateAttr(None)

    def uses(self) -> Mapping[str, str]:
        """Return ``policy``, if it names one."""
        return {"policy": self.policy} if self.policy else {}

    def using(self, task: Task) -> Self:
        """Return these settings with the policy that ``policy`` names."""
        if not self.policy:
            return self
        settings = self.model_copy()
        settings._trained = task.policy("policy")
        return settings


@controller("planner")
class Planner(PlannerSettings, _Improving, Controller):
    """Search for the best trajectory before the episode begins, then play it.

    The cost of a trajectory is its time plus ``smoothness`` seconds for each radian of θ̂_R at
    100 Hz. The search begins with the trajectories of ``level``, ``okada``, ``mpc`` and ``policy``.
    Beam searches on the true ground add more, with ``width`` and twice ``width`` nodes. The best
    trajectory is then improved. Every trajectory is played in the simulated scene, which decides
    its outcome and cost. With a ``smoothness`` above 0, the result is no rougher than the smoothest
    trajectory that the search began with. It is a yardstick for policies and cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True

    def build(self) -> Policy:
        """Return a policy that searches for a plan at the start of each episode.

        Raises:
            ConfigError: ``policy`` names a policy that ``using`` has not read.
        """
        from flipperctl.lookahead.planner import PlannerPolicy

        if self.policy and self._trained is None:
            raise ConfigError(
                f"controller.policy={self.policy}: this command reads no policy for the planner; "
                "flipperctl eval and inspect reward do"
            )
        return PlannerPolicy(self, self._trained)


@controller("rollouts")
class Rollouts(RolloutSettings, _Improving, Controller):
    """Try a policy's best actions in the engine itself, and take the cheapest.

    Each trial lasts some decisions, in which the policy drives on. It costs the change of pitch and
    roll, the way that is not made, and the posture at its end. So it works in 3-D, with pairs and
    with four flippers. It is a yardstick for policies and cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    closed_loop: ClassVar[bool] = True

    def build(self) -> Policy:
        """Return a policy that tries its actions in the simulator of the episode.

        Raises:
            ConfigError: ``using`` has not read the policy that ``policy`` names, or it has rates.
        """
        from flipperctl.lookahead.rollouts import RolloutPolicy

        if self._trained is None or self._trained.kind == "rates":
            raise ConfigError(
                f"policy: {self.policy!r} is no policy of Q-values that this command reads; a run, "
                "a checkpoint, an exported file or a shipped policy is allowed"
            )
        return RolloutPolicy(self, self._trained)


@controller("value_iteration")
class ValueIteration(ValueIterationSettings, Controller):
    """Compute the value of every reachable state of the true ground, then act by it.

    Before an episode, the prediction model explores all flipper settings along the whole ground.
    Value iteration on these states gives the best return of the configured rewards from each. It
    takes one to three seconds. The policy is a yardstick for others and, as a teacher
    (``teacher=searched``), their source of values; it cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    closed_loop: ClassVar[bool] = True
    baselines: ClassVar[tuple[str, ...]] = ("geometric", "level")

    _rewards: Mapping[str, RewardTerm] | None = PrivateAttr(None)

    def paying(self, rewards: Mapping[str, RewardTerm]) -> ValueIteration:
        """Return these settings with the reward terms that count."""
        settings = self.model_copy()
        settings._rewards = rewards
        return settings

    def build(self) -> Policy:
        """Return a policy that explores the ground at the start of each episode.

        Without ``paying``, the paper's rewards count.

        Raises:
            ConfigError: a term needs what predictions lack.
        """
        from flipperctl.lookahead.value_iteration import ValueIterationPolicy

        rewards = self._rewards
        if rewards is None:
            rewards = {n: create("reward", n, f"rewards.{n}") for n in PAPER_REWARDS.values()}
        return ValueIterationPolicy(self, rewards)
