"""Policies that act on the outputs of a network, also in training episodes.

In: a network of torch, or its translation to numpy (``agent.plain``). Out: the best action, rates,
or in training episodes ε-greedy actions, or ones that are drawn by the Q-values, as the policy
gradient does. Without a network of torch, none of them imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.agent.plain import Outputs, PlainNetwork, best
from flipperctl.api import FloatArray, Perception, Simulator, StateGroups
from flipperctl.core.risk import EpisodeRisk, Escape, EscapeRule, drawn
from flipperctl.core.targets import Action, ActionKind, rates_of
from flipperctl.policies.controllers import from_costs, no_label

if TYPE_CHECKING:
    import torch

    from flipperctl.agent.plain import PlainRisk
    from flipperctl.agent.risk import Risk

Driving: TypeAlias = "torch.nn.Module | PlainNetwork"
"""A network that drives, of torch or of numpy."""


def outputs_of(network: Driving, kind: ActionKind = "turns", joints: int = 2) -> Outputs:
    """Return what computes the outputs of a network, of as many numbers as the ``kind`` has."""
    if isinstance(network, PlainNetwork):
        return network
    from flipperctl.agent.networks import TorchNetwork

    return TorchNetwork(network, kind, joints)


class _NetworkPolicy:
    """A policy that acts on the outputs of a network, which takes ``frames`` observations."""

    def __init__(
        self, network: Driving, frames: int, kind: ActionKind = "turns", joints: int = 2
    ) -> None:
        self.network, self.frames, self.kind = outputs_of(network, kind, joints), frames, kind

    def q_values(self, p: Perception) -> list[float]:
        """Return the Q-values, (3^J,)."""
        return self.network.outputs(stacked(p.recent, self.frames))


class TrainedPolicy(_NetworkPolicy):
    """Acts on the outputs of a network in ``eval()`` mode: its rates, or the best Q-value.

    While it escapes, it draws its actions by the Q-values.
    """

    def __init__(
        self,
        network: Driving,
        frames: int = 1,
        risk: Risk | PlainRisk | None = None,
        escape: EscapeRule | None = None,
        kind: ActionKind = "turns",
        joints: int = 2,
    ) -> None:
        """``risk``: the network of its risk on the CPU, if there is one.

        ``escape``: how it draws its actions while that warns; None: it never does.
        """
        super().__init__(network, frames, kind, joints)
        self._risk = risk
        self.risk_sign = None if risk is None else risk.sign
        """When its risk is a warning; None without a risk."""
        self.risk: float | None = None
        """Risk at the last decision; None without one."""
        self._episode: EpisodeRisk | None = None
        self._escape = None if escape is None else Escape(escape)

    def reset(self, simulator: Simulator | None = None) -> None:
        """Begin an episode; only the risk and the escape have a memory."""
        self.risk = self._episode = None
        if self._escape is not None:
            self._escape.reset()

    def act(self, p: Perception) -> Action:
        """Return the index of an action, or rates."""
        return self.act_on(p.recent, p.position)

    def act_on(
        self, recent: Sequence[NDArray[np.float32]], position: FloatArray | None = None
    ) -> Action:
        """Return the action for the newest observations, each (n,) in SI units.

        ``position``: see ``Perception``.
        """
        observation = stacked(recent, self.frames)
        # The risk comes first, since a warning changes how the action is chosen.
        if self._risk is not None:
            if self._episode is None:
                self._episode = self._risk.begin(len(recent[-1]))
            place = None if position is None else position.tolist()
            self.risk = self._risk.of_one(observation, self._episode, place)
        values = self.network.outputs(observation)
        if self.kind == "rates":
            return rates_of(values)
        # While it escapes, the policy draws by its Q-values.
        escape, sign = self._escape, self.risk_sign
        if escape is not None and sign is not None and escape.due(warns=sign.warns(self.risk)):
            return escape.draw(values)
        return best(values)


class ExploringPolicy(_NetworkPolicy):
    """Takes a random action with probability ε, otherwise the greedy action under new noise.

    A network's own noise, if it has any, replaces ε.
    """

    label = None
    groups = None

    def __init__(
        self,
        network: Driving,
        frames: int,
        epsilon: Callable[[], float],
        rng: np.random.Generator,
        noise_rng: np.random.Generator,
        share: float = 1.0,
        joints: int = 2,
    ) -> None:
        """``network`` is put into the mode of decisions at the start of each episode.

        ``epsilon`` is called at each decision. ``rng`` draws the actions, ``noise_rng`` the noise.
        ``share``: share of the episodes that have random actions [-]. ``joints``: J.
        """
        super().__init__(network, frames, joints=joints)
        self._actions = 3**joints
        self._epsilon, self._rng, self._noise_rng = epsilon, rng, noise_rng
        self._share, self._greedy = share, False
        self.explored = False
        """Whether the last action was random."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; decide whether it has random actions."""
        self.network.begin(noise=True)
        self._greedy = self._share < 1 and self._rng.random() >= self._share

    def act(self, p: Perception) -> int:
        """Return the index of a random or greedy action."""
        self.explored = not self._greedy and self._rng.random() < self._epsilon()
        if self.explored:
            return int(self._rng.integers(self._actions))
        self.network.draw_noise(self._noise_rng)
        return best(self.q_values(p))


class SamplingPolicy(_NetworkPolicy):
    """Draws each action with the probabilities softmax(Q / temperature), which are its label."""

    groups: StateGroups | None = None
    explored = False

    def __init__(
        self,
        network: Driving,
        frames: int,
        temperature: Callable[[], float],
        rng: np.random.Generator,
        joints: int = 2,
    ) -> None:
        """``network`` is put into ``eval()`` mode at the start of each episode.

        ``temperature`` is called at each decision [-]. ``rng`` draws. ``joints``: J.
        """
        super().__init__(network, frames, joints=joints)
        self._temperature, self._rng = temperature, rng
        self.label = no_label()
        """Probabilities of the actions at the last decision, (3^J,)."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""
        self.network.begin(noise=False)  # at each decision it took a tenth of the time

    def act(self, p: Perception) -> int:
        """Return the index of the drawn action."""
        self.label = from_costs(-np.array(self.q_values(p)), self._temperature())
        return drawn(self.label.tolist(), self._rng.random())
