"""The policy gradient: actions that returned more than expected become more probable.

In: whole episodes whose actions were drawn with known probabilities. Out: a better policy. It is
softmax(Q / temperature) of the networks that the double DQN has, too, so that its greedy form is
validated, exported and driven alike.

Clipped updates: Schulman et al. 2017, "Proximal policy optimization algorithms"; advantages:
Schulman et al. 2016, "Generalized advantage estimation"; values that see the true state: Pinto et
al. 2018, "Asymmetric actor critic".
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.contract import check_demand
from flipperctl.agent.frames import input_size
from flipperctl.agent.losses import Adam, clipped_gain, descend, divergence, flatten_parameters
from flipperctl.agent.networks import outputs, seeded
from flipperctl.agent.replay import Batch, Replay
from flipperctl.api import Network, ObservationLayout, Training
from flipperctl.checkpoint import LAST, find, read
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig, to_dict
from flipperctl.config.identity import differences
from flipperctl.env.privileged import SIZE
from flipperctl.errors import ConfigError, NonFiniteError
from flipperctl.learners.double_q import Baseline
from flipperctl.learners.pair import NetworkPair, PairLearning
from flipperctl.learners.settings import GradientSettings, linear
from flipperctl.learners.starting import SETTING, load_start
from flipperctl.policies.trained import naming

_VALUE_RATE: Final = 1e-3
"""Adam step of the values [-]."""
_VALUE_PASSES: Final = 8
"""Passes over the decisions of each of the first rounds, in which the values alone learn [-]."""
_WIDTH: Final = 256
"""Width of the layers of the values."""


def advantages(
    differences: NDArray[np.float32], discounts: NDArray[np.float32], trace: float
) -> NDArray[np.float32]:
    """Return the generalised advantages of decisions in chronological order, (T,).

    ``differences``: temporal differences r + γ·V(s') - V(s), (T,); ``discounts``: γ, or 0 at the
    end of an episode, (T,); ``trace``: λ.
    """
    # A_t = δ_t + γ·λ·A_(t+1) from the end backwards; the sum itself is a float64.
    sums, later = np.zeros_like(differences), 0.0
    for t in range(len(differences) - 1, -1, -1):
        later = float(differences[t]) + float(discounts[t]) * trace * later
        sums[t] = later
    return sums


def limited(advantage: torch.Tensor, clip: float | None) -> torch.Tensor:
    """Return advantages (T,) scaled to mean 0 and variance 1.

    They are clipped to ±``clip`` (None: unlimited) and scaled once more: otherwise the few
    decisions before a failure have most of the variance.
    """
    scaled = _scaled(advantage)
    return scaled if clip is None else _scaled(scaled.clamp(-clip, clip))


def _scaled(advantage: torch.Tensor) -> torch.Tensor:
    return (advantage - advantage.mean()) / (advantage.std(unbiased=False) + 1e-8)


def build_values(inputs: int, privileged: int) -> Baseline:
    """Return the values of input rows with ``privileged`` numbers that only they see."""
    return Baseline(inputs, privileged, _WIDTH)


class ClippedGradient(NetworkPair):
    """A pair with the update from the episodes that its own policy drove."""

    settings: GradientSettings

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        settings: GradientSettings,
        **further: Any,
    ) -> None:
        """See ``NetworkPair``; only the values see the privileged states."""
        super().__init__(network, layout, settings, **further)
        # Seeded weights of their own; torch's global generator is restored afterwards.
        with torch.random.fork_rng():
            torch.manual_seed(self._seed)
            values = build_values(input_size(network, layout), further["privileged"])
        self.values = values.to(self.device)
        self._value_parameters = list(self.values.parameters())
        self._value_optimiser = Adam(flatten_parameters(self._value_parameters))
        self.anchor = copy.deepcopy(self.online).requires_grad_(False)
        """The policy that the training started with."""
        self.rounds = 0
        """Number of updates."""
        self.learnt = 0
        """Number of transitions of the run that it has learnt from."""
        self._parts |= {"values": self.values, "anchor": self.anchor}
        self._parts["value_optimiser"] = self._value_optimiser

    def update(self, batch: Batch, fraction: float, rng: np.random.Generator) -> float:
        """Improve the policy and its values by the transitions of whole episodes, in their order.

        The labels of ``batch`` are the probabilities by which its actions were drawn. ``fraction``:
        completed part of the run, 0 to 1, which sets the learning rate and the temperature;
        ``rng`` shuffles. Returns the mean squared error of the values in the last step [-].
        """
        # Forward passes draw by the number of the round alone: a resumed run repeats them.
        with seeded(self.device, self._seed, self.rounds):
            self.online.eval()
            return self._update(batch.to(self.device), fraction, rng)

    def _update(self, batch: Batch, fraction: float, rng: np.random.Generator) -> float:
        s = self.settings
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        temperature = s.temperature_at(fraction)
        # All advantages are computed with the values as they are before the round's first step.
        advantage, goal = self._advantages(batch)
        # In the first rounds the values alone learn: untrained, they would mislead the policy.
        warm, moves = self.rounds < s.warm_up, True
        error = 0.0
        for _ in range(_VALUE_PASSES if warm else s.passes):
            # Each pass meets every decision once, in a new order.
            order = torch.from_numpy(rng.permutation(len(goal))).to(self.device)
            for rows in torch.split(order, s.batch_size):
                step = batch.rows(rows)
                error = self._value_step(step, goal[rows])
                if self.risk is not None:
                    self.risk.step(step, rate)
                # A policy too far from the one that drove rests until the next round.
                if moves and not warm:
                    moved = self._policy_step(step, advantage[rows], temperature, rate)
                    moves = moved <= s.divergence
        self.rounds += 1
        return error

    def _advantages(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the advantages, scaled and limited, and the values to learn, (T,)."""
        assert batch.privileged is not None  # as in every batch of such a training
        assert batch.next_privileged is not None
        # Temporal differences in scaled rewards; no gradient passes into the goals.
        with torch.no_grad():
            value = self.values(batch.observation, batch.privileged)
            after = self.values(batch.next_observation, batch.next_privileged)
            reward = batch.reward * self.settings.reward_scale
            difference = reward + batch.discount * after - value
        # The recursion runs over time on the CPU, for whole episodes in their order.
        advantage = torch.from_numpy(
            advantages(
                difference.cpu().numpy(),
                batch.discount.cpu().numpy(),
                self.settings.trace,
            )
        ).to(self.device)
        # A_t + V(s_t) is the λ-return, which the values learn unscaled.
        return limited(advantage, self.settings.advantage_clip), advantage + value

    def _value_step(self, batch: Batch, goal: torch.Tensor) -> float:
        assert batch.privileged is not None
        loss = (self.values(batch.observation, batch.privileged) - goal).square().mean()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise NonFiniteError(
                f"the loss of the values is {value}; the largest reward of the batch is "
                f"{float(batch.reward.abs().max()):g}"
            )
        descend(loss, self._value_parameters, self._value_optimiser, 1.0, _VALUE_RATE)
        return value

    def _policy_step(
        self, batch: Batch, advantage: torch.Tensor, temperature: float, rate: float
    ) -> float:
        """Take a step of the policy; return its divergence from what drove, before the step."""
        g = self.settings
        assert batch.label is not None  # the probabilities of the draws
        # The clipped objective compares the policy with the probabilities that drew the actions.
        logits = torch.log_softmax(self.online(batch.observation) / temperature, dim=1)
        gain = clipped_gain(logits, batch.action, batch.label, advantage, g.clip)
        loss = -gain
        # The anchor holds back what the advantages do not clearly change.
        if g.anchor:
            with torch.no_grad():
                anchored = torch.softmax(self.anchor.eval()(batch.observation) / temperature, dim=1)
            loss = loss + g.anchor * divergence(anchored, logits)
        if not math.isfinite(value := float(loss.detach())):
            raise NonFiniteError(f"the loss of the policy is {value}")
        # KL(drove | now) before the step: the caller stops the policy by it.
        moved = float(divergence(batch.label, logits.detach()))
        self._descend(loss, rate)
        return moved

    @property
    def starting(self) -> tuple[torch.nn.Module, ...]:
        """The networks that begin with the weights of the training's start."""
        return *super().starting, self.anchor

    def counters(self) -> dict[str, Any]:
        """Return numbers of rounds, of transitions and of each optimiser's steps."""
        steps = [self.optimiser.steps, self._value_optimiser.steps]
        steps.append(0 if self.risk is None else self.risk.optimiser.steps)
        return {"rounds": self.rounds, "learnt": self.learnt, "steps": steps}

    def restore_counters(self, counters: Mapping[str, Any]) -> None:
        """Restore what ``counters`` returned, after the tensors."""
        self.rounds, self.learnt = counters["rounds"], counters["learnt"]
        self.optimiser.steps, self._value_optimiser.steps, risk = counters["steps"]
        if self.risk is not None:
            self.risk.optimiser.steps = risk


_VALUES = "agent.start_values"


def read_values(config: TrainConfig) -> dict[str, torch.Tensor] | None:
    """Return the weights of the values that a training starts with; None: random ones."""
    settings = config.agent
    assert isinstance(settings, GradientSettings)  # which alone asks
    name = settings.start_from
    if not settings.start_values or name is None:
        return None
    # A policy may be the best of its run; values lie in the run's last checkpoint alone.
    with naming(SETTING):
        policy, checkpoint = read(find(Path(name))), read(find(Path(name), prefer=LAST))
        values, source = checkpoint.part("values"), checkpoint.config()
    if not values:
        raise ConfigError(
            f"{_VALUES}: {name} has no values; name in {SETTING} the run of a training with "
            "agent=policy_gradient, or leave it at false"
        )
    state = checkpoint.document.state
    assert state is not None  # of a checkpoint with values
    # Values rate the policy beside which they were saved, not an older best one.
    if policy.document.kind == "best" and policy.document.decision != state.decision:
        raise ConfigError(
            f"{_VALUES}: the best policy of {name} is that of decision {policy.document.decision}, "
            f"its values are those of decision {state.decision}; give {checkpoint.path} in "
            f"{SETTING}, or leave it at false"
        )
    # Values predict discounted sums of scaled rewards, which must be the same sums here.
    if differing := [path for path, *_ in differences(_returns(source), _returns(config))]:
        raise ConfigError(
            f"{_VALUES}: the values of {name} are of other returns, by {', '.join(differing)}; "
            "train with the settings of that run, or leave it at false"
        )
    # Shapes follow from the length of an observation and the network's frames.
    built = build_values(input_size(config.network, config.perception.layout), SIZE)
    try:
        require_equal_layout(values, built.state_dict())
    except ValueError as error:
        raise ConfigError(f"{_VALUES}: the values of {name} do not fit: {error}") from error
    return values


def _returns(config: TrainConfig) -> dict[str, object]:
    """Return the settings that make up the returns which values predict, by their keys."""
    terms = {f"rewards.{name}": to_dict(term) for name, term in config.rewards.items()}
    scale = getattr(config.agent, "reward_scale", None)
    return {"agent.gamma": config.agent.gamma, "agent.reward_scale": scale, **terms}


def check_memory(settings: GradientSettings, config: TrainConfig) -> None:
    """Check that the network, the replay and a batch fit into memory."""
    check_demand(
        config.network,
        config.perception,
        rows=min(settings.replay_size, config.train.decisions),
        drawn=settings.batch_size,
        batch=settings.batch_size,
        labels=outputs("turns", len(config.robot.joints)),
        privileged=SIZE,
        risk=settings.risk,
    )


class GradientLearning(PairLearning):
    """Learns from whole episodes, each in one round."""

    agent: ClippedGradient

    def __init__(self, settings: GradientSettings, training: Training) -> None:
        config: TrainConfig = training.config
        # Refuse what does not fit into memory before anything is allocated.
        check_memory(settings, config)
        agent = ClippedGradient(
            training.network,
            training.layout,
            settings,
            seed=training.seed,
            device=training.device,
            privileged=SIZE,
        )
        # Single transitions, since the advantages sum the rewards; labels are draw probabilities.
        replay = Replay(
            settings.replay_size,
            input_size(training.network, training.layout),
            1,
            settings.gamma,
            labels=agent.actions,
            actions=agent.actions,
            privileged=SIZE,
            risk_horizon=settings.risk_horizon if settings.risk else 0,
            newest=training.layout.size,
        )
        super().__init__(training, agent, replay)
        self._settings = settings

    def begin(self) -> None:
        """Take the weights that the training starts with, of networks and values."""
        load_start(self.training.config, self.agent)
        if (values := read_values(self.training.config)) is not None:
            self.agent.values.load_state_dict(values)

    def end_episode(self, decision: int) -> None:
        """Update from the newest whole episodes if enough decisions are new."""
        # Decisions of whole episodes that no round has learnt from yet.
        new = self.replay.added - self.agent.learnt
        if new > self.replay.capacity:  # one episode is longer than a whole round
            raise ConfigError(
                f"agent.replay_size: {self.replay.capacity:,} decisions are fewer than the "
                f"{new:,} of whole episodes that the policy gradient learns from at once; raise it"
            )
        if new >= self._settings.round_size(self.training.decisions):
            fraction = decision / self.training.decisions
            self.loss = self.agent.update(self.replay.newest(new), fraction, self._sample_rng)
            self.agent.learnt = self.replay.added
            self.updates += 1

    def drop_episode(self) -> None:
        """Forget the episode: the next one would seem to be its rest."""
        self.replay.take_back()

    def counters(self) -> dict[str, Any]:
        """Return the numbers of rounds, transitions and steps."""
        return {**super().counters(), **self.agent.counters()}

    def restore(
        self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
    ) -> None:
        """Restore networks, optimisers, replay and rounds."""
        super().restore(tensors, counters)
        self.agent.restore_counters(counters)
