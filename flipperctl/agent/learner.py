"""What all learners share: an online and a target network, their optimiser, and the risk.

In: a network plugin and its layout. Out: a policy, and gradient steps on losses that a subclass
computes.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.descent import Adam, descend, flatten_parameters, part, restore_moments
from flipperctl.agent.frames import input_size
from flipperctl.agent.networks import TRAINING_COPIES, build_network, record_plugin
from flipperctl.agent.noise import Noise
from flipperctl.agent.risk import RiskLearner
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Agent
from flipperctl.errors import ConfigError
from flipperctl.guard import naming, refusal

Pair = tuple[torch.nn.Module, torch.nn.Module]
"""A network that learns, and the one that follows it slowly."""


def arrays(module: torch.nn.Module) -> dict[str, NDArray[np.generic]]:
    """Return a copy of a network's weights, for policies in other processes."""
    state = module.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}


def _persistent_buffers(module: torch.nn.Module) -> list[str]:
    """Return the names of the buffers that checkpoints hold: statistics, but no noise."""
    saved = module.state_dict().keys()
    return [name for name, _ in module.named_buffers() if name in saved]


class Learner:
    """Online and target network, their optimiser, and the learner of the risk."""

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        n_actions: int,
        settings: Agent,
        *,
        seed: int,
        device: str = "cpu",
        beside: Callable[[], Pair | None] = lambda: None,
    ) -> None:
        """``beside`` builds networks that learn from the same loss, after those of the policy."""
        self.settings, self._seed = settings, seed
        self.device = torch.device(device)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            built = build_network(network, layout, n_actions, copies=TRAINING_COPIES)
            others = beside()
        self.risk = (
            RiskLearner(input_size(network, layout), seed=seed, device=self.device)
            if settings.risk
            else None
        )
        """The learner of the risk, if there is one."""
        if not any(p.requires_grad for p in built.parameters()):
            raise refusal(
                network, "build", "built a network without trainable parameters", ConfigError
            )
        with naming(network, "build", ConfigError):
            self.online = built.to(self.device)
            self.target = copy.deepcopy(self.online).requires_grad_(False)
            # Each network's parameters lie in one vector, so that the optimiser, the clipping and
            # the soft update are one operation each instead of one per layer.
            online, target = [self.online], [self.target]
            if others is not None:
                online.append(others[0])
                target.append(others[1])
            self._online, self._target = flatten_parameters(online), flatten_parameters(target)
            self._buffers = _persistent_buffers(self.online)
        for module in (self.online, self.target):
            record_plugin(module, network)
        self._parameters = [p for module in online for p in module.parameters()]
        self.optimiser = Adam(self._online)
        self._noise, self._target_noise = Noise(self.online), Noise(self.target)
        self._noise.acts()
        self._target_noise.acts()
        self.noise_rng = np.random.default_rng(seed)
        """Generator of the networks' exploration noise, if they have any."""

    @property
    def policy(self) -> torch.nn.Module:
        """The network that is validated and exported."""
        return self.target

    def policy_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return a copy of the policy's weights, and of those of its risk, for other processes."""
        return arrays(self.policy) | ({} if self.risk is None else self.risk.arrays())

    @property
    def starting(self) -> tuple[torch.nn.Module, ...]:
        """The networks that begin with the weights of the training's start."""
        return self.online, self.target

    def take_weights(self, other: Learner) -> None:
        """Take the weights of another learner's networks, which are built alike; keep the rest."""
        self.online.load_state_dict(other.online.state_dict())
        self.target.load_state_dict(other.target.state_dict())

    def _descend(self, loss: torch.Tensor, rate: float) -> None:
        """Take a gradient step of the online network; let the target follow."""
        descend(loss, self._parameters, self.optimiser, self.settings.gradient_norm, rate)
        with torch.no_grad():
            self._target.lerp_(self._online, self.settings.target_rate)
            self._follow_buffers()

    def _follow_buffers(self) -> None:
        """Update the target's statistics at the rate of its weights; copy its integer counts."""
        for name in self._buffers:
            online, target = self.online.get_buffer(name), self.target.get_buffer(name)
            if online.is_floating_point():
                target.lerp_(online, self.settings.target_rate)
            else:
                target.copy_(online)

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the learner's state: its networks and the optimisers' moments."""
        found = {f"online.{k}": v for k, v in self.online.state_dict().items()}
        found |= {f"target.{k}": v for k, v in self.target.state_dict().items()}
        if self.risk is not None:
            found |= self.risk.tensors()
        return found | {f"optimiser.{k}": v for k, v in self.optimiser.moments.items()}

    def restore(self, tensors: Mapping[str, torch.Tensor], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned after ``steps`` gradient steps."""
        self.online.load_state_dict(part(tensors, "online"))
        self.target.load_state_dict(part(tensors, "target"))
        if self.risk is not None:
            self.risk.restore(tensors, steps)
        restore_moments(self.optimiser, part(tensors, "optimiser"), steps)
