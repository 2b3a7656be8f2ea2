"""The double dueling DQN: learns from batches. It knows no environment."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.adam import Adam
from flipperctl.agent.frames import input_size
from flipperctl.agent.heads import Distributional, head
from flipperctl.agent.noise import Noise
from flipperctl.agent.replay import Batch
from flipperctl.agent.schedules import linear
from flipperctl.api import MEMORY, Network, ObservationLayout
from flipperctl.config import Agent
from flipperctl.errors import ConfigError, NonFiniteError

_CPU = torch.device("cpu")


def build_network(network: Network, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
    """The network, after a check of its output's shape.

    Raises:
        ConfigError: it does not map (B, frames · (N + 3)) to (B, n_actions) finite float32 numbers.
    """
    name = f"network {network.plugin_name!r}"
    if not 1 <= network.frames <= MEMORY:
        raise ConfigError(f"{name}: frames is {network.frames}; 1 to {MEMORY} is allowed")
    module = network.build(layout, n_actions)
    if not isinstance(module, torch.nn.Module):
        raise ConfigError(f"{name}: build must return a torch module; got {type(module).__name__}")
    probe = torch.zeros(2, input_size(network, layout))
    try:
        with torch.no_grad():
            output = module(probe)
    except RuntimeError as error:
        raise ConfigError(
            f"{name} fails on observations of shape {tuple(probe.shape)}: "
            f"{str(error).splitlines()[0]}"
        ) from error
    shape = tuple(output.shape) if isinstance(output, torch.Tensor) else type(output).__name__
    if shape != (2, n_actions):
        raise ConfigError(
            f"{name}: observations {tuple(probe.shape)} must give Q-values (2, {n_actions}); "
            f"the output is {shape}"
        )
    if output.dtype != torch.float32 or not bool(output.isfinite().all()):
        raise ConfigError(
            f"{name}: the Q-values must be finite float32 numbers; "
            f"for observations of zeros they are {output.dtype}, such as {output[0, 0]}"
        )
    if isinstance(module, Distributional):
        shape = tuple(module.quantiles(probe).shape)
        if len(shape) != 3 or shape[:2] != (2, n_actions) or not shape[2]:
            raise ConfigError(
                f"{name}: observations {tuple(probe.shape)} must give quantiles "
                f"(2, {n_actions}, K); they are {shape}"
            )
    return module


def greedy(
    module: torch.nn.Module, observation: NDArray[np.float32], device: torch.device = _CPU
) -> int:
    """The action of the largest Q-value of a network on ``device``.

    ``observation``: what the network sees, (frames · (N + 3),).
    """
    with torch.inference_mode():
        return int(module(torch.from_numpy(observation).to(device).unsqueeze(0)).argmax())


def arrays(module: torch.nn.Module) -> dict[str, NDArray[np.generic]]:
    """A copy of a network's weights, for those who play elsewhere."""
    state = module.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}


def _joined(module: torch.nn.Module) -> torch.Tensor:
    """Move the parameters of a module into one vector, (P,), of which they become views."""
    parameters = list(module.parameters())
    vector = torch.cat([p.detach().reshape(-1) for p in parameters])
    parts = torch.split(vector, [p.numel() for p in parameters])
    for parameter, part in zip(parameters, parts, strict=True):
        parameter.data = part.view_as(parameter)
    return vector


class D3qn:
    """Online and target network, their optimiser, and how they learn."""

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        n_actions: int,
        settings: Agent,
        *,
        seed: int,
        device: str = "cpu",
    ) -> None:
        self.settings = settings
        self.device = torch.device(device)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.online = build_network(network, layout, n_actions).to(self.device)
        self.target = copy.deepcopy(self.online).requires_grad_(False)
        # Each network's parameters lie in one vector, so that the optimiser, the clipping and the
        # soft update are one operation each instead of one a layer.
        self._online, self._target = _joined(self.online), _joined(self.target)
        self._parameters = list(self.online.parameters())
        self.optimiser = Adam(self._online)
        self._head = head(self.online)
        self._noise, self._target_noise = Noise(self.online), Noise(self.target)
        self.noise_rng = np.random.default_rng(seed)
        """What the noise of the networks is drawn from, if they have any."""

    @property
    def policy(self) -> torch.nn.Module:
        """The network that is validated and exported."""
        return self.target if self.settings.act_with == "target" else self.online

    @contextmanager
    def judged(self) -> Iterator[torch.nn.Module]:
        """The policy in ``eval()`` mode, without its noise, until it is left."""
        try:
            yield self.policy.eval()
        finally:
            self.policy.train()

    def update(self, batch: Batch, share: float) -> float:
        """Gradient steps of ``batch_size`` transitions each; ``share`` of the run is over.

        ``batch`` holds a whole number of them. The targets of all are computed before the first.
        Returns the last loss.

        Raises:
            NonFiniteError: a loss is not finite.
        """
        s = self.settings
        rate = linear(s.learning_rate, s.learning_rate_end, share)
        batch = batch.to(self.device)
        self._noise.draw(self.noise_rng)
        self._target_noise.draw(self.noise_rng)
        with torch.no_grad():
            reward = batch.reward * s.reward_scale
            targets = self._head.targets(reward, batch, self.online, self.target)
        value = 0.0
        for start in range(0, len(targets), s.batch_size):
            part = slice(start, start + s.batch_size)
            value = self._step(batch.observation[part], batch.action[part], targets[part], rate)
            if not math.isfinite(value):
                raise NonFiniteError(
                    f"the learner's loss is {value}; the largest reward of the batch "
                    f"is {float(batch.reward.abs().max()):g}"
                )
        return value

    def _step(
        self, observation: torch.Tensor, action: torch.Tensor, target: torch.Tensor, rate: float
    ) -> float:
        self._noise.draw(self.noise_rng)
        loss = self._head.loss(self.online, observation, action, target)
        value = float(loss.detach())
        if not math.isfinite(value):
            return value  # the caller raises; the weights stay whole
        gradients = torch.autograd.grad(loss, self._parameters)
        with torch.no_grad():
            gradient = torch.cat([g.reshape(-1) for g in gradients])
            norm = float(torch.linalg.vector_norm(gradient))
            if norm > self.settings.gradient_norm:
                gradient.mul_(self.settings.gradient_norm / norm)
            self.optimiser.step(gradient, rate)
            self._target.lerp_(self._online, self.settings.target_rate)
        return value

    def tensors(self) -> dict[str, torch.Tensor]:
        """All that learning needs to go on: both networks and the optimiser's moments."""
        found = {f"online.{k}": v for k, v in self.online.state_dict().items()}
        found |= {f"target.{k}": v for k, v in self.target.state_dict().items()}
        return found | {f"optimiser.{k}": v for k, v in self.optimiser.moments.items()}

    def restore(self, tensors: dict[str, torch.Tensor], steps: int) -> None:
        """Take back what ``tensors`` gave, after as many gradient steps."""
        parts: dict[str, dict[str, torch.Tensor]] = {"online": {}, "target": {}, "optimiser": {}}
        for name, tensor in tensors.items():
            part, _, key = name.partition(".")
            if part in parts:
                parts[part][key] = tensor
        self.online.load_state_dict(parts["online"])
        self.target.load_state_dict(parts["target"])
        for name, moment in self.optimiser.moments.items():
            moment.copy_(parts["optimiser"][name])
        self.optimiser.steps = steps
