"""A controller plugin as a policy: what it raises names it, and so does what is no action."""

from __future__ import annotations

from flipperctl.api import Controller, Perception, Policy, Simulator
from flipperctl.env.actions import ALLOWED, action_index
from flipperctl.guard import fault, refusal, short_repr


class PluginPolicy:
    """The policy that a controller builds, under guard."""

    def __init__(self, controller: Controller) -> None:
        """Build the controller's policy.

        Raises:
            PluginFailedError: the controller's code failed, or what it built is no policy.
        """
        self._controller = controller
        try:
            self._policy: Policy = controller.build()
        except BaseException as error:
            raise fault(error, controller, "build") from error
        if not all(callable(getattr(self._policy, name, None)) for name in ("reset", "act")):
            text = f"returned {short_repr(self._policy)}; an object with reset and act is allowed"
            raise refusal(controller, "build", text)

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
            PluginFailedError: the controller's code failed, or its answer is no action.
        """
        try:
            answer: object = self._policy.act(p)
            index = action_index(answer)
        except BaseException as error:
            raise fault(error, self._controller, "act") from error
        if index is None:
            raise refusal(self._controller, "act", f"returned {short_repr(answer)}; {ALLOWED}")
        return index
