"""The double dueling DQN: it learns from batches, whatever the environment."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.acting import greedy
from flipperctl.agent.adam import Adam
from flipperctl.agent.baseline import Baselines
from flipperctl.agent.building import (
    TRAINING_COPIES,
    build_network,
    naming_network,
    record_plugin,
)
from flipperctl.agent.frames import input_size
from flipperctl.agent.groups import GroupBatch
from flipperctl.agent.heads import choose_head
from flipperctl.agent.losses import (
    mean_value_penalty,
    searched_values,
    teacher_cross_entropy,
    teacher_large_margin,
)
from flipperctl.agent.noise import Noise
from flipperctl.agent.replay import Batch
from flipperctl.agent.risk import RiskLearner
from flipperctl.agent.schedules import linear
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Agent, Teacher
from flipperctl.errors import ConfigError, NonFiniteError
from flipperctl.guard import naming, refusal

__all__ = ["D3qn", "arrays", "build_network", "greedy"]


def arrays(module: torch.nn.Module) -> dict[str, NDArray[np.generic]]:
    """Return a copy of a network's weights, for policies in other processes."""
    state = module.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}


def _persistent_buffers(module: torch.nn.Module) -> list[str]:
    """Return the names of the buffers that checkpoints hold: statistics, but no noise."""
    saved = module.state_dict().keys()
    return [name for name, _ in module.named_buffers() if name in saved]


def _flatten_parameters(modules: Sequence[torch.nn.Module]) -> torch.Tensor:
    """Move the modules' parameters into one vector, (P,); they become views of it."""
    parameters = [p for module in modules for p in module.parameters()]
    vector = torch.cat([p.detach().reshape(-1) for p in parameters])
    parts = torch.split(vector, [p.numel() for p in parameters])
    for parameter, part in zip(parameters, parts, strict=True):
        parameter.data = part.view_as(parameter)
    return vector


class D3qn:
    """Online and target network, their optimiser, and the update from a batch."""

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        n_actions: int,
        settings: Agent,
        *,
        seed: int,
        device: str = "cpu",
        teacher: Teacher | None = None,
        privileged: int = 0,
    ) -> None:
        """``teacher``: settings of the imitation of the batches' labels; None without labels.

        ``privileged``: length of the batches' privileged states, 0 without them.
        """
        self.settings, self._teacher = settings, teacher
        self.device = torch.device(device)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            built = build_network(network, layout, n_actions, copies=TRAINING_COPIES)
            self.baselines = (
                Baselines(input_size(network, layout), privileged).to(self.device)
                if privileged
                else None
            )
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
            if self.baselines is not None:
                online.append(self.baselines.online)
                target.append(self.baselines.target)
            self._online, self._target = _flatten_parameters(online), _flatten_parameters(target)
            self._buffers = _persistent_buffers(self.online)
        for module in (self.online, self.target):
            record_plugin(module, network)
        self._parameters = [p for module in online for p in module.parameters()]
        self.optimiser = Adam(self._online)
        self._head = choose_head(self.online)
        self._noise, self._target_noise = Noise(self.online), Noise(self.target)
        self.noise_rng = np.random.default_rng(seed)
        """Generator of the networks' exploration noise, if they have any."""

    @property
    def policy(self) -> torch.nn.Module:
        """The network that is validated and exported."""
        return self.target if self.settings.act_with == "target" else self.online

    def policy_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return a copy of the policy's weights, and of those of its risk, for other processes."""
        return arrays(self.policy) | ({} if self.risk is None else self.risk.arrays())

    @contextmanager
    def evaluation_mode(self) -> Iterator[torch.nn.Module]:
        """Keep the policy in ``eval()`` mode, without noise, within the context."""
        try:
            yield self.policy.eval()
        finally:
            self.policy.train()

    def update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch] = ()) -> float:
        """Take gradient steps of ``batch_size`` transitions each; return the last loss [-].

        ``batch`` holds the transitions of one or more steps; their targets are all computed before
        the first step. ``fraction``: completed part of the run, 0 to 1, which sets the learning
        rate and the weight of the labels. ``groups``: valued states for each step.

        Raises:
            NonFiniteError: a loss is not finite.
            PluginFailedError: the network's code failed.
        """
        with naming_network(self.online, "forward"):  # only its own code can fail here
            return self._update(batch, fraction, groups)

    def _update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch]) -> float:
        s = self.settings
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        batch = batch.to(self.device)
        self._noise.draw(self.noise_rng)
        self._target_noise.draw(self.noise_rng)
        with torch.no_grad():
            reward = batch.reward * s.reward_scale
            only_imitates = self._teacher is not None and not self._teacher.td_weight
            targets = (
                reward
                if only_imitates
                else self._head.targets(reward, batch, self.online, self.target)
            )
            if self.baselines is not None:
                targets = self.baselines.with_next(targets, batch)
        value = 0.0
        for start in range(0, len(targets), s.batch_size):
            part = slice(start, start + s.batch_size)
            valued = groups[start // s.batch_size].to(self.device) if groups else None
            step = batch.rows(part)
            value = self._step(step, targets[part], rate, fraction, valued)
            if self.risk is not None:
                self.risk.step(step, rate)
            if not math.isfinite(value):
                raise NonFiniteError(
                    f"the learner's loss is {value}; the largest reward of the batch "
                    f"is {float(batch.reward.abs().max()):g}"
                )
        return value

    def _difference_loss(self, batch: Batch, target: torch.Tensor) -> torch.Tensor:
        """Return the loss of the temporal difference."""
        if self.baselines is None:
            return self._head.loss(self.online, batch.observation, batch.action, target)
        left, pull = self.baselines.without_present(target, batch)
        return self._head.loss(self.online, batch.observation, batch.action, left) + pull

    def _loss(
        self, batch: Batch, target: torch.Tensor, fraction: float, groups: GroupBatch | None
    ) -> torch.Tensor:
        """Return the temporal-difference loss, plus the loss of what a teacher says."""
        s = self._teacher
        if s is None:
            return self._difference_loss(batch, target)
        if s.loss == "values":
            td = self._difference_loss(batch, target)
            if groups is None:
                return s.td_weight * td
            scale = self.settings.reward_scale
            found = self.online(groups.observation.flatten(0, 1)).unflatten(
                0, groups.observation.shape[:2]
            )
            searched = searched_values(found, groups.values * scale, s.clip)
            return s.td_weight * td + linear(s.weight, s.weight_end, fraction) * searched
        assert batch.label is not None  # the replay of a run with a teacher has labels
        values = self.online(batch.observation)
        if s.loss == "margin":
            imitation = teacher_large_margin(values, batch.label, s.margin)
        else:
            imitation = teacher_cross_entropy(values, batch.label, s.q_temperature)
        loss = linear(s.weight, s.weight_end, fraction) * imitation
        if not s.td_weight:
            return loss + mean_value_penalty(values)
        return s.td_weight * self._difference_loss(batch, target) + loss

    def _step(
        self,
        batch: Batch,
        target: torch.Tensor,
        rate: float,
        fraction: float,
        groups: GroupBatch | None,
    ) -> float:
        self._noise.draw(self.noise_rng)
        loss = self._loss(batch, target, fraction, groups)
        value = float(loss.detach())
        if not math.isfinite(value):
            return value  # the caller raises; the weights are not changed
        gradients = torch.autograd.grad(loss, self._parameters)
        with torch.no_grad():
            gradient = torch.cat([g.reshape(-1) for g in gradients])
            norm = float(torch.linalg.vector_norm(gradient))
            if norm > self.settings.gradient_norm:
                gradient.mul_(self.settings.gradient_norm / norm)
            self.optimiser.step(gradient, rate)
            self._target.lerp_(self._online, self.settings.target_rate)
            self._follow_buffers()
        return value

    def _follow_buffers(self) -> None:
        """Update the target's statistics at the rate of its weights; copy its integer counts."""
        for name in self._buffers:
            online, target = self.online.get_buffer(name), self.target.get_buffer(name)
            if online.is_floating_point():
                target.lerp_(online, self.settings.target_rate)
            else:
                target.copy_(online)

    def take_weights(self, other: D3qn) -> None:
        """Take the weights of another learner's networks, which are built alike; keep the rest."""
        self.online.load_state_dict(other.online.state_dict())
        self.target.load_state_dict(other.target.state_dict())

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the learner's state: both networks and the optimiser's moments."""
        found = {f"online.{k}": v for k, v in self.online.state_dict().items()}
        found |= {f"target.{k}": v for k, v in self.target.state_dict().items()}
        if self.baselines is not None:
            found |= {f"baselines.{k}": v for k, v in self.baselines.state_dict().items()}
        if self.risk is not None:
            found |= self.risk.tensors()
        return found | {f"optimiser.{k}": v for k, v in self.optimiser.moments.items()}

    def restore(self, tensors: dict[str, torch.Tensor], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned after ``steps`` gradient steps."""
        names = ("online", "target", "baselines", "optimiser")
        parts: dict[str, dict[str, torch.Tensor]] = {name: {} for name in names}
        for name, tensor in tensors.items():
            part, _, key = name.partition(".")
            if part in parts:
                parts[part][key] = tensor
        self.online.load_state_dict(parts["online"])
        self.target.load_state_dict(parts["target"])
        if self.baselines is not None:
            self.baselines.load_state_dict(parts["baselines"])
        if self.risk is not None:
            self.risk.restore(tensors, steps)
        for name, moment in self.optimiser.moments.items():
            moment.copy_(parts["optimiser"][name])
        self.optimiser.steps = steps
