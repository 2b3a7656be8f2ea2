"""A controller plugin as a policy; its errors and invalid actions name the plugin."""

from __future__ import annotations

import numpy as np

from flipperctl.api import (
    ACTIONS,
    Controller,
    CostPolicy,
    FloatArray,
    Perception,
    Policy,
    Simulator,
)
from flipperctl.api.controllers import Rule
from flipperctl.env.actions import ALLOWED, action_index
from flipperctl.guard import fault, refusal, short_repr


class PluginPolicy:
    """Runs the policy that a controller plugin builds and reports its errors with its name."""

    def __init__(self, controller: Controller) -> None:
        """Build the controller's policy.

        Raises:
            PluginFailedError: the controller's code failed, or it built an object without
                ``reset`` and ``act``.
        """
        self._controller = controller
        try:
            self._policy: Policy = controller.build()
        except BaseException as error:
            raise fault(error, controller, "build") from error
        if not all(callable(getattr(self._policy, name, None)) for name in ("reset", "act")):
            text = f"returned {short_repr(self._policy)}; an object with reset and act is allowed"
            raise refusal(controller, "build", text)
        self._teacher = self._policy if isinstance(self._policy, CostPolicy) else None

    @property
    def offers_costs(self) -> bool:
        """Whether the policy offers the cost of each action."""
        return self._teacher is not None

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode.

        Raises:
            PluginFailedError: the controller's code failed.
        """
        try:
            self._policy.reset(simulator)
        except BaseException as error:
            raise fault(error, self._controller, "reset") from error

    def act(self, p: Perception) -> int:
        """Return the controller's action.

        Raises:
            PluginFailedError: the controller's code failed, or it returned no valid action.
        """
        try:
            answer: object = self._policy.act(p)
            index = action_index(answer)
        except BaseException as error:
            raise fault(error, self._controller, "act") from error
        if index is None:
            owner = None if isinstance(self._policy, Rule) else type(self._policy)
            text = f"returned {short_repr(answer)}; {ALLOWED}"
            raise refusal(self._controller, "act", text, owner=owner)
        return index

    def costs(self, p: Perception) -> FloatArray:
        """Return the policy's cost of each action, (9,) [s]; only if it ``offers_costs``.

        Raises:
            PluginFailedError: the controller's code failed, or a cost is missing or not finite.
        """
        try:
            answer: object = self._cost_policy().costs(p)
            found = np.asarray(answer, np.float64)
        except BaseException as error:
            raise fault(error, self._controller, "costs") from error
        if found.shape != (len(ACTIONS),) or not np.isfinite(found).all():
            text = f"returned {short_repr(answer)}; {len(ACTIONS)} finite costs are allowed"
            raise refusal(self._controller, "costs", text, owner=type(self._policy))
        return found

    def took(self, action: int) -> None:
        """Tell the policy which action was taken after its ``costs``.

        Raises:
            PluginFailedError: the controller's code failed.
        """
        try:
            self._cost_policy().took(action)
        except BaseException as error:
            raise fault(error, self._controller, "took") from error

    def _cost_policy(self) -> CostPolicy:
        if self._teacher is None:
            raise TypeError(f"{type(self._policy).__name__} offers no costs")
        return self._teacher
