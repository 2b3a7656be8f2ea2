"""``mpc``: registers the receding-horizon controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PrivateAttr

from flipperctl.api import Controller, Policy, controller
from flipperctl.errors import ConfigError
from flipperctl.lookahead.learned import LearnedValue
from flipperctl.lookahead.mpc_settings import MpcSettings


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

    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")
    reference_settings: ClassVar[Mapping[str, Any]] = {"value": ""}

    _learned: LearnedValue | None = PrivateAttr(None)

    def ending_with(self, learned: LearnedValue) -> Mpc:
        """Return these settings with the values that ``value`` names.

        The caller reads the file: this package knows neither checkpoints nor networks.
        """
        settings = self.model_copy()
        settings._learned = learned
        return settings

    def without_value(self) -> Mpc:
        """Return these settings with the hand-set cost."""
        return self.model_copy(update={"value": ""})

    def build(self) -> Policy:
        """Return a policy that plans with these settings.

        Raises:
            ConfigError: ``value`` names values that ``ending_with`` was not given, there are
                ``rewards`` without it, or a term needs what predictions lack.
        """
        from flipperctl.lookahead.policy import MpcPolicy
        from flipperctl.lookahead.return_policy import ReturnPolicy

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
