"""The risk that an episode fails soon, learnt beside the values by a small separate network.

In: batches of the replay, whose transitions tell whether their episode failed within the next
``agent.risk_horizon`` decisions. Out: a network of log-odds, and one of probabilities.

The labels are Monte-Carlo ones: every failure is an end of an episode, so an episode that has ended
tells the label of each of its decisions exactly. A temporal difference with the failure as its
reward would need a value for each number of decisions left, and would pass on its own errors.

The network sees the same input as the policy, and how much the newest observation resembles earlier
ones (``core.risk``). It shares nothing with the policy, neither features, optimiser nor random
numbers: the policy learns bit for bit the same with and without it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.losses import Adam, flatten_parameters
from flipperctl.agent.networks import load_arrays, one_thread
from flipperctl.agent.plain import RISK, Weights
from flipperctl.agent.replay import UNKNOWN, Batch
from flipperctl.core.risk import LAGS, EpisodeRisk, Place, RiskCalibration, RiskSign
from flipperctl.errors import NonFiniteError

POSITIVES: Final = 5.0
"""Weight in the loss of a transition shortly before a failure [-], which is rare once the policy is
good. It multiplies the odds that the network learns, which the calibration's shift takes back."""
_WIDTH: Final = 64


class RiskNetwork(torch.nn.Module):
    """Maps inputs of the policy to log-odds, and to what each resemblance adds to them."""

    def __init__(self, inputs: int) -> None:
        """``inputs``: length of an input row, frames · n."""
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(inputs, _WIDTH),
            torch.nn.ReLU(),
            torch.nn.Linear(_WIDTH, _WIDTH),
            torch.nn.ReLU(),
            torch.nn.Linear(_WIDTH, 1 + len(LAGS)),
        )

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the log-odds, (B, 1), and the coefficients of the resemblances, (B, lags).

        ``observation``: input rows, (B, frames · n) in SI units.
        """
        outputs: torch.Tensor = self.layers(observation)
        return outputs[:, :1], outputs[:, 1:]

    def log_odds(self, observation: torch.Tensor, resembles: torch.Tensor) -> torch.Tensor:
        """Return the log-odds of rows with their resemblances (B, lags), (B,)."""
        # Log-odds are linear in the resemblances to earlier observations of the episode.
        alone, coefficients = self(observation)
        logits: torch.Tensor = alone.squeeze(1) + (coefficients * resembles).sum(dim=1)
        return logits


class Risk(torch.nn.Module):
    """Maps inputs of the policy to calibrated probabilities and coefficients."""

    def __init__(
        self, network: RiskNetwork, calibration: RiskCalibration, stride: float = 0.0
    ) -> None:
        """``stride``: way that the belts command in a decision, see ``EpisodeRisk`` [m]."""
        super().__init__()
        self.stride = stride
        self.network, self.sign = network, calibration.sign
        self.slope, self.shift = calibration.slope, calibration.shift

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the risks of input rows alone, (B, 1), and the coefficients, (B, lags)."""
        alone, coefficients = self.network(observation)
        return torch.sigmoid(self.slope * alone + self.shift), self.slope * coefficients

    def load(self, weights: Weights) -> None:
        """Give the network the weights of another process."""
        load_arrays(self.network, weights)

    def begin(self, size: int) -> EpisodeRisk:
        """Return what remembers a new episode; ``size``: length n of an observation."""
        return EpisodeRisk(size, self.sign, self.stride)

    def of_one(
        self, observation: NDArray[np.float32], episode: EpisodeRisk, place: Place | None = None
    ) -> float:
        """Return the risk of an episode's next input row, (frames · n,).

        ``place``: where the robot is by odometry, see ``EpisodeRisk.update``.
        """
        # One row on one thread; the memory of the episode turns log-odds into its risk.
        device = next(self.network.parameters()).device
        row = torch.from_numpy(observation).to(device).unsqueeze(0)
        with one_thread():
            alone, coefficients = self(row)
        risk = episode.update(float(alone), coefficients[0].cpu().numpy(), observation, place)
        if not math.isfinite(risk):
            raise NonFiniteError(f"the risk of an observation is {risk}")
        return risk


def uncalibrated(horizon: int) -> RiskCalibration:
    """Return the calibration before any validation, which only takes the weight back."""
    return RiskCalibration(RiskSign(horizon, 0.5), 1.0, -math.log(POSITIVES))


def plain_risk(network: RiskNetwork, horizon: int) -> Risk:
    """Return the network's output as probabilities that no calibration has changed."""
    return Risk(network, RiskCalibration(RiskSign(horizon, 0.5), 1.0, 0.0))


def risk_loss(output: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
    """Return the weighted log loss of log-odds (B,) for labels (B,), averaged over known ones.

    A label is 1 shortly before a failure, else 0, or ``UNKNOWN``.
    """
    # A label that is not known weighs nothing; the rare positives weigh more.
    known = (label != UNKNOWN).to(output.dtype)
    weights = known * (1 + (POSITIVES - 1) * (label > 0).to(output.dtype))
    losses = torch.nn.functional.binary_cross_entropy_with_logits(
        output, label.clamp(min=0), reduction="none"
    )
    return (weights * losses).sum() / known.sum().clamp(min=1)


class RiskLearner:
    """The risk network of a training with its own optimiser."""

    def __init__(self, inputs: int, *, seed: int, device: torch.device) -> None:
        """``inputs``: length of an input row; ``seed``: of the first weights."""
        # Weights follow from the seed; torch's global generator is restored afterwards.
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.network = RiskNetwork(inputs).to(device)
        self._parameters = list(self.network.parameters())
        self.optimiser = Adam(flatten_parameters(list(self.network.parameters())))

    def step(self, batch: Batch, rate: float) -> float:
        """Take a gradient step with the learning rate ``rate``; return the loss [-]."""
        assert batch.failing is not None  # as in every batch of such a training
        assert batch.resembles is not None
        loss = risk_loss(self.network.log_odds(batch.observation, batch.resembles), batch.failing)
        if not math.isfinite(value := float(loss.detach())):
            raise NonFiniteError(f"the loss of the risk is {value}")
        gradients = torch.autograd.grad(loss, self._parameters)
        with torch.no_grad():
            self.optimiser.step(torch.cat([g.reshape(-1) for g in gradients]), rate)
        return value


def policy_arrays(
    policy: torch.nn.Module, risk: torch.nn.Module | None
) -> dict[str, NDArray[np.generic]]:
    """Return a copy of the weights of a policy and of its risk, named for other processes."""
    weights = weights_of(policy)
    if risk is not None:
        weights |= {f"{RISK}{name}": array for name, array in weights_of(risk).items()}
    return weights


def weights_of(module: torch.nn.Module) -> dict[str, NDArray[np.generic]]:
    """Return a copy of a network's weights, for other processes."""
    state = module.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}
