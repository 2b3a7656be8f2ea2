"""What both learners share: an online and a target network, their optimiser, replay, and the risk.

In: a network plugin and its layout. Out: a policy, and gradient steps on losses that a subclass
computes.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import torch

from flipperctl.agent.frames import input_size
from flipperctl.agent.losses import Adam, descend, flatten_parameters
from flipperctl.agent.networks import Noise, build_policy, outputs, record_plugin
from flipperctl.agent.replay import Replay
from flipperctl.agent.risk import RiskLearner
from flipperctl.api import Learning, Network, ObservationLayout, Outcome, Step, Training
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import Teacher
from flipperctl.errors import ConfigError
from flipperctl.learners.settings import PairSettings
from flipperctl.plugging.guard import naming, refusal


class NetworkPair:
    """Online and target network, their optimiser, and the learner of the risk."""

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        settings: PairSettings,
        *,
        seed: int,
        device: str = "cpu",
        teacher: Teacher | None = None,
        privileged: int = 0,
    ) -> None:
        """``teacher``: settings of the imitation of the batches' labels; None without labels.

        ``privileged``: length of the batches' privileged states, 0 without them.
        """
        self.settings, self._seed, self._teacher = settings, seed, teacher
        self.device = torch.device(device)
        self._parts: dict[str, torch.nn.Module | Adam] = {}
        """The learner's state, by its names in a checkpoint."""
        inputs, self.actions = input_size(network, layout), outputs("turns", len(layout.joints))
        # The weights follow from the seed alone; torch's global generator is restored afterwards.
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            built = build_policy(network, layout)
            auxiliary = self._build_auxiliary(inputs, privileged)
        self.risk = RiskLearner(inputs, seed=seed, device=self.device) if settings.risk else None
        """The learner of the risk, if there is one."""
        if not any(p.requires_grad for p in built.parameters()):
            raise refusal(
                network, "build", "built a network without trainable parameters", ConfigError
            )
        # Moving and copying call the plugin's code, whose errors name it.
        with naming(network, "build", ConfigError):
            self.online = built.to(self.device)
            self.target = copy.deepcopy(self.online).requires_grad_(False)
            # The parameters that learn lie in one vector for each network, so that the optimiser,
            # the clipping and the soft update are one operation each instead of one per layer.
            pairs = [
                (learns, follows)
                for learner, follower in [(self.online, self.target), *auxiliary]
                for learns, follows in zip(learner.parameters(), follower.parameters(), strict=True)
                if learns.requires_grad
            ]
            self._parameters, followers = map(list, zip(*pairs, strict=True))
            self._online, self._target = map(flatten_parameters, (self._parameters, followers))
            saved = self.online.state_dict().keys()  # of buffers: statistics, but no noise
            self._buffers = [name for name, _ in self.online.named_buffers() if name in saved]
        for module in (self.online, self.target):
            record_plugin(module, network)
        # Online and target drive and value with noise, if they have any, but without dropout.
        self.optimiser = Adam(self._online)
        self._noise, self._target_noise = Noise(self.online), Noise(self.target)
        self._noise.acts()
        self._target_noise.acts()
        self.noise_rng = np.random.default_rng(seed)
        """Generator of the networks' exploration noise, if they have any."""
        # The pair's parts stand first in a checkpoint, though the subclass built its own before.
        further, self._parts = self._parts, {"online": self.online, "target": self.target}
        if self.risk is not None:
            self._parts |= {"risk": self.risk.network, "risk_optimiser": self.risk.optimiser}
        self._parts |= {"optimiser": self.optimiser, **further}

    def _build_auxiliary(
        self, inputs: int, privileged: int
    ) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
        """Build auxiliary networks of the same loss, each with one that follows it slowly."""
        return []

    @property
    def policy(self) -> torch.nn.Module:
        """The network that is validated and exported."""
        return self.target

    @property
    def starting(self) -> tuple[torch.nn.Module, ...]:
        """The networks that begin with the weights of the training's start."""
        return self.online, self.target

    def _descend(self, loss: torch.Tensor, rate: float) -> None:
        """Take a gradient step of the online network; let the target follow."""
        descend(loss, self._parameters, self.optimiser, self.settings.gradient_norm, rate)
        with torch.no_grad():
            self._target.lerp_(self._online, self.settings.target_rate)
            for name in self._buffers:  # statistics follow as weights do; integer counts are copied
                online, target = self.online.get_buffer(name), self.target.get_buffer(name)
                if online.is_floating_point():
                    target.lerp_(online, self.settings.target_rate)
                else:
                    target.copy_(online)

    def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
        """Return the state by part: the networks and the optimisers' moments."""
        return {name: module.state_dict() for name, module in self._parts.items()}

    def restore(self, tensors: Mapping[str, Mapping[str, torch.Tensor]], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned after ``steps`` gradient steps."""
        require_equal_parts(tensors, self.tensors())
        for name, module in self._parts.items():
            module.load_state_dict(tensors[name])
            if isinstance(module, Adam):
                module.steps = steps


def require_equal_parts(
    tensors: Mapping[str, Mapping[str, torch.Tensor]],
    expected: Mapping[str, Mapping[str, torch.Tensor]],
) -> None:
    """Check that parts of a checkpoint have the expected tensors.

    Raises:
        ValueError: one has not; the text names it.
    """
    for name, wanted in expected.items():
        try:
            require_equal_layout(tensors.get(name, {}), wanted)
        except ValueError as error:
            raise ValueError(f"its part {name} is not valid: {error}") from error


class PairLearning(Learning):
    """A pair of networks, and a replay of all decisions."""

    def __init__(
        self,
        training: Training,
        agent: NetworkPair,
        replay: Replay,
        bootstrapped: Collection[Outcome] = (),
    ) -> None:
        """``bootstrapped``: outcomes after which the target still includes the next value."""
        self.training, self.agent, self.replay = training, agent, replay
        self.policy, self.driving = agent.policy, agent.online
        self.risk = None if agent.risk is None else agent.risk.network
        self._bootstrapped = bootstrapped
        self._sample_rng = training.generators["sample"]
        training.generators["noise"] = agent.noise_rng

    def add(self, step: Step, decision: int) -> None:
        """Put a decision into the replay."""
        ending = step.ending
        assert isinstance(step.action, int)  # these learners choose among turns
        self.replay.add(
            step.observation,
            step.action,
            step.reward,
            step.next_observation,
            over=ending is not None,
            bootstrap=ending is not None and ending["outcome"] in self._bootstrapped,
            explored=step.explored,
            failed=ending is not None and ending["outcome"] != Outcome.REACHED,
            label=step.label,
            privileged=step.privileged,
            next_privileged=step.next_privileged,
        )

    def drop_episode(self) -> None:
        """Forget the decisions that still lack later rewards."""
        self.replay.drop_pending()

    def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
        """Return networks, optimisers and replay."""
        return {**self.agent.tensors(), "replay": self.replay.tensors()}

    def counters(self) -> dict[str, Any]:
        """Return how many transitions were added and are kept."""
        return {"added": self.replay.added, "kept": self.replay.kept}

    def restore(
        self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
    ) -> None:
        """Restore networks, optimisers and replay."""
        self.agent.restore(tensors, self.updates)
        try:
            replay = tensors.get("replay", {})
            self.replay.restore_tensors(replay, counters["added"], counters["kept"])
        except ValueError as error:
            raise ValueError(f"its part replay is not valid: {error}") from error
