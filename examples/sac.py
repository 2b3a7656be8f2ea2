"""Soft actor-critic with continuous turns, as a learner in one file.

    flipperctl train agent=sac actions=rates terrain=uplift --plugins examples/sac.py

Haarnoja et al. 2018, "Soft actor-critic algorithms and applications": two critics, a policy that
draws, and a temperature that keeps its entropy.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import Learner, Learning, Perception, Policy, Simulator, Step, Training, learner
from flipperctl.core.targets import ActionKind, Rates

if TYPE_CHECKING:
    import torch


@learner("sac")
class Sac(Learner):
    """Learn continuous turns by soft actor-critic."""

    default_network: ClassVar[str] = "mlp"

    learning_rate: float = Field(3e-4, gt=0, le=1, description="Adam step [-]")
    batch_size: int = Field(128, ge=2, le=65536, description="transitions per update [-]")
    replay_size: int = Field(100_000, ge=100, le=10**7, description="capacity of the replay [-]")
    learning_starts: int = Field(
        1000, ge=1, le=10**7, description="decisions by random rates before the first update [-]"
    )
    update_every: int = Field(2, ge=1, le=1000, description="decisions per update [-]")
    target_rate: float = Field(0.005, gt=0, le=1, description="share of the critics in targets [-]")
    reward_scale: float = Field(1.0, gt=0, le=1e6, description="factor of rewards [-]")

    @property
    def drives(self) -> tuple[ActionKind, ...]:
        """Rates alone."""
        return ("rates",)

    def first_update(self, config: Any) -> tuple[int, str]:
        """Return the decisions before the first update."""
        starts = self.learning_starts
        return starts, f"learning starts after agent.learning_starts={starts} decisions"

    def build(self, training: Training) -> Learning:
        """Return actor, critics and replay."""
        return _learning()(self, training)

    def driving_network(self, training: Training) -> torch.nn.Module:
        """Return the actor, which knows how far to draw around the policy's rates."""
        return actor(training)

    def drive(
        self,
        training: Training,
        module: torch.nn.Module,
        decision: Callable[[], int],
        rng: np.random.Generator,
    ) -> Policy:
        """Return the policy that draws, at first uniformly."""
        return Drawing(
            module, training.network.frames, lambda: decision() < self.learning_starts, rng
        )


class Drawing:
    """Draws rates of the actor."""

    def __init__(
        self, module: Any, frames: int, uniform: Callable[[], bool], rng: np.random.Generator
    ) -> None:
        self._module, self._frames, self._uniform, self._rng = module, frames, uniform, rng

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode, of which nothing is remembered."""

    def act(self, p: Perception) -> Rates:
        """Return the rates of both pairs."""
        import torch

        from flipperctl.agent.frames import stacked

        if self._uniform():
            front, rear = self._rng.uniform(-1, 1, 2).tolist()
            return front, rear
        row = torch.from_numpy(stacked(p.recent, self._frames)).unsqueeze(0)
        with torch.no_grad():
            (rates,) = draw(self._module, row, self._rng)[0].tolist()
        return rates[0], rates[1]


def layers(inputs: int, outputs: int) -> torch.nn.Sequential:
    """Return a perceptron with two hidden layers."""
    from torch.nn import Linear, ReLU, Sequential

    return Sequential(
        Linear(inputs, 128), ReLU(), Linear(128, 128), ReLU(), Linear(128, outputs)
    )  # fmt: skip


def actor(training: Training) -> torch.nn.ModuleDict:
    """Return the policy, and the network of its logarithmic spread."""
    import torch

    inputs = training.network.frames * training.layout.size
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        spread = layers(inputs, 2)
    return torch.nn.ModuleDict({"policy": training.policy_network(), "spread": spread})


def draw(
    module: Any, rows: torch.Tensor, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return rates (B, 2) and the logarithms of their densities (B,) for input rows (B, n)."""
    import torch

    mean = module["policy"][0](rows)  # before the hyperbolic tangent
    spread = module["spread"](rows).clamp(-5, 2)
    noise = torch.from_numpy(rng.standard_normal(mean.shape, dtype=np.float32))
    before = mean + spread.exp() * noise
    # The density of the normal distribution, and the slope of the tangent (their appendix C).
    density = -0.5 * noise.square() - spread - 0.5 * np.log(2 * np.pi)
    slope = 2 * (np.log(2) - before - torch.nn.functional.softplus(-2 * before))
    return before.tanh(), (density - slope).sum(dim=1)


def _learning() -> type[Learning]:
    """Return the class of what learns; it is made here, since it needs torch."""
    import torch
    from torch.nn.functional import mse_loss

    from flipperctl.agent.losses import Adam, descend, flatten_parameters

    class SacLearning(Learning):
        """Actor, critics, temperature and replay of a run."""

        def __init__(self, settings: Sac, training: Training) -> None:
            self._settings = settings
            self._rng = training.generators["sample"]
            inputs = training.network.frames * training.layout.size
            self.driving = self._actor = actor(training)
            self.policy = self._actor["policy"]
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(training.seed + 1)
                self._critics = torch.nn.ModuleList([layers(inputs + 2, 1) for _ in range(2)])
            self._targets = copy.deepcopy(self._critics).requires_grad_(False)
            self._temperature = torch.nn.ParameterList([torch.zeros(1)])
            self._modules = {"actor": self._actor, "critics": self._critics}
            self._modules["temperature"] = self._temperature
            self._weights = {n: list(m.parameters()) for n, m in self._modules.items()}
            self._optimisers = {n: Adam(flatten_parameters(w)) for n, w in self._weights.items()}
            sizes = {
                "observation": inputs,
                "action": 2,
                "reward": 1,
                "following": inputs,
                "goes_on": 1,
            }
            rows = settings.replay_size
            self._replay = {n: np.zeros((rows, size), np.float32) for n, size in sizes.items()}
            self._added = 0

        def add(self, step: Step, decision: int) -> None:
            """Store a decision, and update if one is due."""
            row = self._added % self._settings.replay_size
            values = (step.observation, step.action, step.reward, step.next_observation)
            for array, value in zip(
                self._replay.values(), (*values, step.ending is None), strict=True
            ):
                array[row] = value
            self._added += 1
            s = self._settings
            if decision >= s.learning_starts and decision % s.update_every == 0:
                self._update()
                self.updates += 1

        def _update(self) -> None:
            s, alpha = self._settings, float(self._temperature[0].detach().exp())
            stored = min(self._added, s.replay_size)
            chosen = self._rng.integers(stored, size=s.batch_size)
            batch = {name: torch.from_numpy(array[chosen]) for name, array in self._replay.items()}
            # The critics learn the soft value of what the policy would do next.
            with torch.no_grad():
                rates, density = draw(self._actor, batch["following"], self._rng)
                value = self._values(self._targets, batch["following"], rates) - alpha * density
                reward = s.reward_scale * batch["reward"].squeeze(1)
                goal = reward + s.gamma * batch["goes_on"].squeeze(1) * value
            pairs = torch.cat([batch["observation"], batch["action"]], dim=1)
            loss = sum(mse_loss(critic(pairs).squeeze(1), goal) for critic in self._critics)
            self.loss = float(self._descend("critics", loss))
            # The policy draws what the critics value, and keeps its entropy near -2.
            rates, density = draw(self._actor, batch["observation"], self._rng)
            value = self._values(self._critics, batch["observation"], rates)
            self._descend("actor", (alpha * density - value).mean())
            self._descend("temperature", (self._temperature[0] * (2 - density.detach())).mean())
            with torch.no_grad():
                for old, new in zip(
                    self._targets.parameters(), self._weights["critics"], strict=True
                ):
                    old.lerp_(new, s.target_rate)

        def _values(self, critics: Any, rows: Any, rates: Any) -> torch.Tensor:
            """Return the lower value of both critics, (B,)."""
            pairs = torch.cat([rows, rates], dim=1)
            return torch.minimum(*(critic(pairs).squeeze(1) for critic in critics))

        def _descend(self, name: str, loss: Any) -> Any:
            rate = self._settings.learning_rate
            descend(loss, self._weights[name], self._optimisers[name], 10.0, rate)
            return loss.detach()

        def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
            """Return networks, moments and replay."""
            used = min(self._added, self._settings.replay_size)
            moments = {f"{n}_optimiser": o.state_dict() for n, o in self._optimisers.items()}
            networks = {n: m.state_dict() for n, m in self._modules.items()}
            networks["targets"] = self._targets.state_dict()
            replay = {n: torch.from_numpy(array[:used]) for n, array in self._replay.items()}
            return {**networks, **moments, "replay": replay}

        def counters(self) -> dict[str, Any]:
            """Return the number of transitions and those of steps."""
            steps = {name: optimiser.steps for name, optimiser in self._optimisers.items()}
            return {"added": self._added, "steps": steps}

        def restore(
            self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
        ) -> None:
            """Restore all of it."""
            for name, module in (*self._modules.items(), ("targets", self._targets)):
                module.load_state_dict(tensors[name])
            for name, optimiser in self._optimisers.items():
                optimiser.load_state_dict(tensors[f"{name}_optimiser"])
                optimiser.steps = counters["steps"][name]
            for name, array in self._replay.items():
                array[: len(tensors["replay"][name])] = tensors["replay"][name].numpy()
            self._added = counters["added"]

    return SacLearning
