"""Trained networks as policies, also in training episodes, and values for searches.

In: a checkpoint. Out: its network with the trained weights, the policy that acts by it, and the
value of observations with the rewards and the discount of the training. Policies of training
episodes are ε-greedy, or draw their actions by the Q-values, as the policy gradient does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size, stacked
from flipperctl.agent.networks import Noise, best, build_policy, one_thread, q_values
from flipperctl.agent.risk import Risk, RiskNetwork, uncalibrated
from flipperctl.api import (
    ACTIONS,
    FloatArray,
    LearnedValue,
    Perception,
    RobotGeometry,
    Simulator,
    StateGroups,
)
from flipperctl.api.controllers import TOLERANCE
from flipperctl.checkpoint import Checkpoint, read_policy
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.core.risk import EpisodeRisk, Escape, EscapeRule, RiskCalibration, drawn
from flipperctl.core.targets import Action, ActionKind, rates_of
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.controllers import from_costs, no_label


class _NetworkPolicy:
    """A policy that acts on the outputs of a network, which takes ``frames`` observations."""

    def __init__(self, module: torch.nn.Module, frames: int, kind: ActionKind = "turns") -> None:
        self.module, self.frames, self.kind = module, frames, kind
        self._device = next(module.parameters(), torch.empty(0)).device

    def q_values(self, p: Perception) -> list[float]:
        """Return the Q-values, (9,)."""
        return q_values(self.module, stacked(p.recent, self.frames), self._device)


class TrainedPolicy(_NetworkPolicy):
    """Acts on the outputs of a network in ``eval()`` mode: its rates, or the best Q-value.

    While it escapes, it draws its actions by the Q-values.
    """

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int = 1,
        risk: Risk | None = None,
        escape: EscapeRule | None = None,
        kind: ActionKind = "turns",
    ) -> None:
        """``risk``: the network of its risk on the CPU, if there is one.

        ``escape``: how it draws its actions while that warns; None: it never does.
        """
        super().__init__(module, frames, kind)
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
        """Return the index of an action, 0 to 8, or rates."""
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
        values = q_values(self.module, observation, self._device, self.kind)
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
        module: torch.nn.Module,
        frames: int,
        epsilon: Callable[[], float],
        rng: np.random.Generator,
        noise_rng: np.random.Generator,
        share: float = 1.0,
    ) -> None:
        """``module`` is put into the mode of decisions at the start of each episode.

        ``epsilon`` is called at each decision. ``rng`` draws the actions, ``noise_rng`` the noise.
        ``share``: share of the episodes that have random actions [-].
        """
        super().__init__(module, frames)
        self._epsilon, self._rng, self._noise_rng = epsilon, rng, noise_rng
        self._noise = Noise(module)
        self._share, self._greedy = share, False
        self.explored = False
        """Whether the last action was random."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; decide whether it has random actions."""
        self._noise.acts()
        self._greedy = self._share < 1 and self._rng.random() >= self._share

    def act(self, p: Perception) -> int:
        """Return the index of a random or greedy action."""
        self.explored = not self._greedy and self._rng.random() < self._epsilon()
        if self.explored:
            return int(self._rng.integers(len(ACTIONS)))
        self._noise.draw(self._noise_rng)
        return best(self.q_values(p))


class SamplingPolicy(_NetworkPolicy):
    """Draws each action with the probabilities softmax(Q / temperature), which are its label."""

    groups: StateGroups | None = None
    explored = False

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int,
        temperature: Callable[[], float],
        rng: np.random.Generator,
    ) -> None:
        """``module`` is put into ``eval()`` mode at the start of each episode.

        ``temperature`` is called at each decision [-]. ``rng`` draws.
        """
        super().__init__(module, frames)
        self._temperature, self._rng = temperature, rng
        self.label = no_label()
        """Probabilities of the actions at the last decision, (9,)."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""
        self.module.eval()  # at each decision it took a tenth of the time

    def act(self, p: Perception) -> int:
        """Return the index of the drawn action."""
        self.label = from_costs(-np.array(self.q_values(p)), self._temperature())
        return drawn(self.label.tolist(), self._rng.random())


def policy_module(checkpoint: Checkpoint) -> torch.nn.Module:
    """Return the network of a checkpoint with its trained weights, on the CPU, in ``eval()`` mode.

    It maps observations (B, F · n) of F frames in SI units to Q-values (B, 9) or rates (B, 2).
    """
    config = checkpoint.policy_config()
    try:
        module = build_policy(config.network, config.perception, config.actions)
    except ConfigError as error:
        raise CheckpointError(f"{checkpoint.path}: {error}") from error
    # The best checkpoint holds the validated weights; in others, the target network acts.
    weights = checkpoint.part("policy" if checkpoint.document.kind == "best" else "target")
    try:
        require_equal_layout(weights, module.state_dict())
    except ValueError as error:
        raise CheckpointError(
            f"{checkpoint.path}: the weights do not fit network "
            f"{config.network.plugin_name!r}: {error}"
        ) from error
    module.load_state_dict(weights)
    return module.eval().requires_grad_(False)


def policy_risk(checkpoint: Checkpoint) -> Risk | None:
    """Return the network of a policy's risk with its calibration; None if it learnt none.

    It maps observations (B, F · n) of F frames in SI units to probabilities (B, 1).
    """
    config, document = checkpoint.policy_config(), checkpoint.document
    if (settings := config.agent.failure_risk) is None:
        return None
    network = RiskNetwork(input_size(config.network, config.perception))
    weights = checkpoint.part("risk")
    # The policy's validation calibrates it, or the run's last validation, if there is any.
    validations = document.state.validations if document.state else (document.validation,)
    calibration = uncalibrated(settings.horizon)
    try:
        require_equal_layout(weights, network.state_dict())
        if validations and (validation := validations[-1]):
            calibration = RiskCalibration.of(validation.__pydantic_extra__)
    except ValueError as error:
        raise CheckpointError(f"{checkpoint.path}: its risk is not valid: {error}") from error
    network.load_state_dict(weights)
    # A robot that moves by far less than this in each decision stands.
    stride = config.robot.track_speed * config.robot.decision_period
    return Risk(network, calibration, stride).eval().requires_grad_(False)


@contextmanager
def naming(path: str) -> Iterator[None]:
    """Begin the texts of errors about a file with ``path``, the setting that names the file."""
    try:
        yield
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error


def read_value(file: Path, name: str, path: str) -> LearnedValue:
    """Return the values of a checkpoint, which the setting at ``path`` calls ``name``."""
    with naming(path):
        checkpoint = read_policy(file)
        config = checkpoint.policy_config()
    network, teacher = config.network, config.teacher
    named = (checkpoint.document.config.model_extra or {}).get("teacher")
    taught = isinstance(named, Mapping) and named.get("controller") is not None  # missing here
    # A plan predicts a single observation, and its end needs an estimate of a return.
    if network.frames > 1:
        fault = (
            f"its network {network.plugin_name} takes {network.frames} observations, of which a "
            "plan predicts one; a network of one observation is allowed"
        )
    elif (teacher.teaches or taught) and not teacher.td_weight and teacher.loss != "values":
        fault = (
            "it only imitated its teacher, so that its values estimate no return; train with "
            "teacher.td_weight above 0, or with experiment=searched"
        )
    elif config.agent.value_scale is None:
        fault = (
            f"it learnt by agent={config.agent.plugin_name}, so that its outputs order the actions "
            "and estimate no return; train with agent=d3qn, or with experiment=searched"
        )
    else:
        return value_of(policy_module(checkpoint), config)
    raise CheckpointError(f"{path}={name}: {fault}")


read_value_once = cache(read_value)


def value_of(module: torch.nn.Module, config: TrainConfig) -> LearnedValue:
    """Return the values of a network of one observation, in ``eval()`` mode, and its training."""
    scale = config.agent.value_scale
    assert scale is not None  # of a learner that estimates returns

    def value(observations: NDArray[np.float32]) -> FloatArray:
        with one_thread():
            best = module(torch.from_numpy(observations)).amax(dim=1)
        return np.asarray(best.numpy(), np.float64) / scale

    layout, sizes = config.perception.layout, dict(_sizes(config))
    return LearnedValue(value, config.rewards, config.agent.gamma, layout, sizes)


def _sizes(config: TrainConfig) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each dimension of the training's robots with its smallest and largest size [m, rad]."""
    for name in RobotGeometry.model_fields:
        size, sampled = getattr(config.robot, name), config.randomise.find("robot", name)
        # Sampled robots count up to the ends of their range, others within a tolerance.
        low, high = (1 - TOLERANCE) * size, (1 + TOLERANCE) * size
        if sampled is not None:
            low, high = sampled.ends
        for factor, scaled in config.robot.factors.items():
            by = config.randomise.find("robot", factor)
            if by is not None and name in scaled:
                low, high = low * by.ends[0], high * by.ends[1]
        yield name, (low, high)
