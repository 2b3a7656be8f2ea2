"""Controllers as policies: of a plugin, whose errors name it, or of one function."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np

from flipperctl.api import (
    ACTIONS,
    Controller,
    CostPolicy,
    FloatArray,
    Perception,
    Policy,
    Simulator,
    StateGroups,
)
from flipperctl.api.controllers import Rule
from flipperctl.config.identity import foreign_plugins
from flipperctl.env.repeating import require_unmoved
from flipperctl.env.termination import ALLOWED, action_index
from flipperctl.guard import naming, refusal, short_repr
from flipperctl.randomness import global_states


class FunctionPolicy:
    """Decides by a function and has no memory."""

    def __init__(self, rule: Callable[[Perception], int]) -> None:
        self._rule = rule

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; the policy has no memory."""

    def act(self, p: Perception) -> int:
        """Return the action that the function returns."""
        return self._rule(p)


def plugin_policy(controller: Controller) -> PluginPolicy:
    """Return the policy that a controller builds."""
    with naming(controller, "build"):  # what it returned may fail as well
        policy = controller.build()
        lacks = [n for n in ("reset", "act") if not callable(getattr(policy, n, None))]
        found = PluginPolicy(controller, policy)
    if lacks:
        text = (
            f"returned {short_repr(policy)}, which lacks {' and '.join(lacks)}; an object with "
            "reset and act is allowed"
        )
        raise refusal(controller, "build", text)
    return found


class PluginPolicy:
    """Runs the policy that a controller plugin built.

    Every method raises ``PluginFailedError`` if the controller's code failed or returned a value
    that the contract does not allow.
    """

    def __init__(self, controller: Controller, policy: Policy) -> None:
        """Run ``policy``, which ``controller`` built."""
        self._controller, self._foreign = controller, foreign_plugins([controller])
        self._policy: Any = policy
        self.offers_costs = isinstance(policy, CostPolicy)
        """Whether ``costs`` and ``took`` may be called."""
        self.follows = self.offers_costs and callable(getattr(policy, "follow", None))
        """Whether ``follow`` may be called: it can label single decisions of another policy."""
        self.values_states = self.offers_costs and callable(getattr(policy, "groups", None))
        """Whether ``state_groups`` may be called."""

    def _calling(self, method: str) -> AbstractContextManager[None]:
        """Return a context for a call of ``method``, in which errors name the controller."""
        call = naming(self._controller, method)
        return self._watching(call, method) if self._foreign else call

    @contextmanager
    def _watching(self, call: naming, method: str) -> Iterator[None]:
        before = global_states()
        with call:
            yield
        require_unmoved(before, self._foreign, f"in {method}")

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        with self._calling("reset"):
            self._policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the controller's action."""
        with self._calling("act"):
            answer: object = self._policy.act(p)
            index = action_index(answer)
        if index is None:
            owner = None if isinstance(self._policy, Rule) else type(self._policy)
            text = f"returned {short_repr(answer)}; {ALLOWED}"
            raise refusal(self._controller, "act", text, owner=owner)
        return index

    def costs(self, p: Perception) -> FloatArray:
        """Return the policy's finite cost of each action, (9,) [s]."""
        with self._calling("costs"):
            answer: object = self._policy.costs(p)
            found = np.asarray(answer, np.float64)
        if found.shape != (len(ACTIONS),) or not np.isfinite(found).all():
            text = f"returned {short_repr(answer)}; {len(ACTIONS)} finite costs are allowed"
            raise refusal(self._controller, "costs", text, owner=type(self._policy))
        return found

    def took(self, action: int) -> None:
        """Tell the policy which action was taken after its ``costs``."""
        with self._calling("took"):
            self._policy.took(action)

    def follow(self, p: Perception, action: int) -> None:
        """Tell the policy what another one perceived and did."""
        with self._calling("follow"):
            self._policy.follow(p, action)

    def state_groups(self, rng: np.random.Generator) -> StateGroups:
        """Return groups of states of the episode's ground with finite values of their actions."""
        with self._calling("groups"):
            found: object = self._policy.groups(rng)
            shaped = isinstance(found, StateGroups) and (
                found.observations.ndim == 3
                and found.values.shape == (*found.observations.shape[:2], len(ACTIONS))
                and found.values.size > 0
                and bool(np.isfinite(found.values).all())
                and bool(np.isfinite(found.observations).all())
            )
        if not shaped:
            text = f"returned {short_repr(found)}; StateGroups of finite numbers are allowed"
            raise refusal(self._controller, "groups", text, owner=type(self._policy))
        assert isinstance(found, StateGroups)
        return found
