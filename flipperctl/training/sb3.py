"""Training by a learner of Stable-Baselines3 (``method=sb3``); only this module imports it.

In: a configuration. Out: a run as our own learners have them: episodes with seeds of their own,
validations, metrics, checkpoints without pickles. The policy's weights are those of ``network=mlp``
of the same widths, so that evaluation, export and robots need nothing of Stable-Baselines3.
"""

from __future__ import annotations

import inspect
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from flipperctl import checkpoint
from flipperctl.agent.learner import join
from flipperctl.agent.networks import build_policy
from flipperctl.api import Listener
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import Generators, State, require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.config.describe import Field
from flipperctl.config.method import DEFAULTS
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError, MissingExtraError
from flipperctl.messages import close_match
from flipperctl.rollout.collect import InProcessCollector
from flipperctl.rollout.episode import training_seed
from flipperctl.training.base import BaseTrainer, Stop

try:
    import stable_baselines3
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.utils import LinearSchedule

    import flipperctl.figures  # noqa: F401  # the library imports matplotlib under any MPLBACKEND
except ImportError as error:
    raise MissingExtraError(
        "method=sb3 needs the package stable-baselines3; install flipperctl[sb3]"
    ) from error

_OURS = {
    "env": "set terrain, robot and the like",
    "seed": "set seed",
    "device": "set device",
    "gamma": "set agent.gamma",
    "policy": "set network.hidden",
    "tensorboard_log": "set logger=tensorboard",
    **dict.fromkeys(
        ("verbose", "_init_setup_model", "replay_buffer_class", "rollout_buffer_class"),
        "leave it out",
    ),
}
"""Arguments that are the run's, and what to do instead of giving them."""
_WITHIN: Mapping[str, Callable[[float], bool]] = {
    "": lambda value: True,
    "≥ 0, ≤ 1": lambda value: 0 <= value <= 1,
    "a whole number ≥ 0": lambda value: isinstance(value, int) and value >= 0,
    "a whole number ≥ -1": lambda value: isinstance(value, int) and value >= -1,
}
"""What bounds of arguments say; the library takes a buffer of -1 and a ``tau`` of 5."""
_ARCHITECTURE = ("net_arch", "activation_fn", "features_extractor_class")


class Scaled(BaseFeaturesExtractor):
    """Divide observations by ``ObservationLayout.scale``, as our networks do."""

    scale: torch.Tensor

    def __init__(self, observation_space: gymnasium.spaces.Box, scale: tuple[float, ...]) -> None:
        super().__init__(observation_space, len(scale))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Map (B, n) in SI units to (B, n) [-]."""
        return observation / self.scale


class _Episodes(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Gives each episode the seed and the difficulty that the run has for it."""

    def __init__(self, trainer: BaseTrainer) -> None:
        super().__init__(_environment(trainer.config))
        self._trainer = trainer
        self.seed, self.difficulty = 0, 1.0

    def reset(self, **ignored: Any) -> Any:
        """Begin the next training episode."""
        progress = self._trainer.progress
        self.seed = training_seed(self._trainer.config.seed, progress.started)
        self.difficulty = progress.difficulty
        progress.started += 1
        return self.env.reset(seed=self.seed, options={"difficulty": self.difficulty})


def arguments(algorithm: str) -> Iterator[Field]:
    """Yield the arguments that ``method.settings`` takes, as the library describes them.

    Its signature tells counts, and its text which of them may be -1 and what is a share.
    """
    cls = _class_of(algorithm)
    texts = dict(re.findall(r":param (\w+):(.*?)(?=\n:param|\Z)", inspect.getdoc(cls) or "", re.S))
    for name, parameter in inspect.signature(cls).parameters.items():
        if name in _OURS:
            continue
        text, bounds = " ".join(texts.get(name, "").split()), ""
        if "between 0 and 1" in text:
            bounds = "≥ 0, ≤ 1"
        elif parameter.annotation is int:
            bounds = f"a whole number ≥ {'-1' if '-1' in text else '0'}"
        default = DEFAULTS[algorithm].get(name, parameter.default)
        yield Field(name, str(parameter.annotation), default, bounds, "", text)


def check_settings(config: TrainConfig) -> None:
    """Refuse arguments that the algorithm does not take, or that settings of the run replace."""
    method = config.method
    assert method is not None  # else our own learner trains
    cls = _class_of(method.algorithm)
    parameters = inspect.signature(cls).parameters
    known = {one.name: one for one in arguments(method.algorithm)}
    for name, value in method.settings.items():
        where = f"method.settings.{name}"
        if name in _OURS:
            raise ConfigError(f"{where}: it is the run's; {_OURS[name]}")
        if name not in known:
            raise ConfigError(
                f"{where}: {cls.__name__} has no such argument{close_match(name, known)}; "
                f"known: {', '.join(known)}"
            )
        is_number = isinstance(parameters[name].default, int | float)
        if is_number and isinstance(value, str) and "str" not in str(parameters[name].annotation):
            raise ConfigError(f"{where}: a number is allowed; the value is {value!r}")
        bounds = known[name].bounds
        if isinstance(value, int | float) and not _WITHIN[bounds](value):
            raise ConfigError(f"{where}: {bounds} is allowed; the value is {value}")
    own = method.settings.get("policy_kwargs") or {}
    for name in own if isinstance(own, dict) else ():
        if name in _ARCHITECTURE:
            raise ConfigError(
                f"method.settings.policy_kwargs.{name}: the network is network=mlp; "
                "network.hidden sets its widths"
            )
    with _own_generators(config.seed):
        _model(config, _environment(config))


def _environment(config: TrainConfig) -> FlipperEnv:
    return FlipperEnv(config=config.environment(), actions=config.actions)


def _class_of(algorithm: str) -> type[BaseAlgorithm]:
    found: type[BaseAlgorithm] = getattr(stable_baselines3, algorithm.upper())
    return found


def _model(config: TrainConfig, env: gymnasium.Env[Any, Any]) -> BaseAlgorithm:
    """Return the algorithm with an untrained policy."""
    method = config.method
    assert method is not None
    arguments: dict[str, Any] = dict(method.settings)
    rate = arguments.get("learning_rate")
    if isinstance(rate, list):
        arguments["learning_rate"] = LinearSchedule(rate[0], rate[1], 1.0)
    if isinstance(arguments.get("train_freq"), list):
        arguments["train_freq"] = tuple(arguments["train_freq"])
    if (noise := arguments.get("action_noise")) is not None:
        arguments["action_noise"] = NormalActionNoise(np.zeros(2), np.full(2, float(noise)))
    hidden: Sequence[int] = cast("Any", config.network).hidden
    policy = {
        **(arguments.pop("policy_kwargs", None) or {}),
        "net_arch": list(hidden),
        "activation_fn": nn.LeakyReLU,
        "features_extractor_class": Scaled,
        "features_extractor_kwargs": {"scale": tuple(config.perception.scale.tolist())},
    }
    cls, gamma = _class_of(method.algorithm), config.agent.gamma
    arguments |= {"policy_kwargs": policy, "gamma": gamma, "device": config.device}
    try:
        made = cls("MlpPolicy", env, **arguments)
    except (TypeError, ValueError, AssertionError, IndexError, MemoryError) as error:
        raise ConfigError(f"method.settings: {cls.__name__} refuses them: {error}") from error
    made.set_logger(Logger(None, []))
    if config.actions == "rates" and isinstance(
        head := getattr(made.policy, "action_net", None), nn.Linear
    ):
        made.policy.action_net = nn.Sequential(head, nn.Tanh())  # the mean of PPO and A2C
    return made


def _layers(model: BaseAlgorithm) -> list[nn.Linear]:
    """Return the linear layers from an observation to Q-values, logits or rates."""
    policy: Any = model.policy
    if hasattr(policy, "q_net"):
        parts = [policy.q_net.q_net]
    elif hasattr(policy, "action_net"):
        parts = [policy.mlp_extractor.policy_net, policy.action_net]
    else:
        parts = [getattr(policy.actor, "latent_pi", nn.Identity()), policy.actor.mu]
    return [layer for part in parts for layer in part.modules() if isinstance(layer, nn.Linear)]


@contextmanager
def _own_generators(seed: int) -> Iterator[None]:
    """Seed the global generators, from which Stable-Baselines3 draws; restore them afterwards."""
    numbers, python = np.random.get_state(), random.getstate()  # noqa: NPY002
    with torch.random.fork_rng():
        stable_baselines3.common.utils.set_random_seed(seed)
        try:
            yield
        finally:
            np.random.set_state(numbers)  # noqa: NPY002
            random.setstate(python)


class Sb3Trainer(BaseTrainer):
    """A run by a learner of Stable-Baselines3."""

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        super().__init__(config, directory, listeners)
        (word,) = np.random.SeedSequence(config.seed).generate_state(1).tolist()
        self._seed = word
        self._network = build_policy(config.network, self.env.layout, config.actions)
        self._episodes = _Episodes(self)
        with _own_generators(word):
            self.model = _model(config, self._episodes)
        self._validating(self)

    def _exploring(self) -> tuple[float | None, int]:
        return getattr(self.model, "exploration_rate", None), 0

    def _first_update(self) -> tuple[int, str] | None:
        """Return when an off-policy algorithm learns; another one says what a rollout lacks."""
        if not isinstance(self.model, OffPolicyAlgorithm):
            return None
        starts = self.model.learning_starts
        return starts + 1, (
            f"learning starts after method.settings.learning_starts={starts} decisions"
        )

    @torch.no_grad()
    def _trained(self) -> nn.Module:
        """Return our network with the weights of the policy."""
        own = [m for m in self._network.modules() if isinstance(m, nn.Linear)]
        for ours, theirs in zip(own, _layers(self.model), strict=True):
            ours.load_state_dict({name: t.cpu() for name, t in theirs.state_dict().items()})
        return self._network

    def policy_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the weights of our network."""
        return {name: t.numpy().copy() for name, t in self._trained().state_dict().items()}

    def _policy(self) -> Mapping[str, Mapping[str, torch.Tensor]]:
        return {"policy": self._trained().state_dict()}

    def _run(self, stop: Stop, opened: ExitStack) -> bool:
        self._save_all()
        collector = InProcessCollector(lambda: iter(()), stop)
        done, budget = self.progress.decision, self.config.train.decisions
        self.model.num_timesteps = done
        following = _Following(self, collector, stop)
        if isinstance(self.model, OnPolicyAlgorithm) and 0 < budget - done < self.model.n_steps:
            end = "learns once, from these alone" if budget - done > 1 else "stays as it is"
            self._report(
                f"train.decisions={budget} leaves less than a rollout of "
                f"method.settings.n_steps={self.model.n_steps} decisions, {budget - done}: the "
                f"policy {end}"
            )
        if done < budget:
            with _own_generators((self._seed + done) % 2**32):
                self.model.learn(
                    budget - done,
                    callback=following,
                    log_interval=budget,
                    reset_num_timesteps=False,
                )
            following.count()
        finished = not following.stopped
        if finished and self._validation_due():
            finished = self._validate(collector)
        self._save_all()
        return finished

    def end_episode(self, info: Mapping[str, Any]) -> None:
        """Take in an episode that has ended."""
        own = {"seed": self._episodes.seed, "difficulty": self._episodes.difficulty}
        self._end_episode({**own, "outcome": str(info["outcome"]), **info["metrics"]})

    def validate_or_save(self, collector: InProcessCollector, before: int) -> bool:
        """Do what is due between two episodes; return False if the run is to stop.

        ``before``: decisions of the run after the episode before.
        """
        every = self.config.train.checkpoint_every
        due = self._validation_due()
        if due and not self._validate(collector):
            return False
        if due or self.progress.decision // every > before // every:
            self._save_all()
        return True

    def _save_all(self) -> None:
        tensors = {"target": self._trained().state_dict(), "sb3": self._held()}
        replay = self._replay()
        tensors |= {} if replay is None else {"replay": replay}
        blank = np.random.default_rng(0).bit_generator.state
        state = self._state(
            orders=(),
            replay_added=0 if replay is None else len(replay["reward"]),
            replay_kept=0,
            groups_added=0,
            generators=Generators.model_validate(dict.fromkeys(Generators.model_fields, blank)),
        )
        document = checkpoint.describe(self.config, "last", state=state)
        self._write_last(document, join(tensors))
        self._save_best()

    def _held(self) -> dict[str, torch.Tensor]:
        """Return the weights and the moments of the optimisers, by names without dots in them."""
        found: dict[str, torch.Tensor] = {}
        for part, state in self.model.get_parameters().items():
            if "param_groups" not in state:
                found |= {f"{part}/{name}": tensor for name, tensor in state.items()}
                continue
            for at, moments in state["state"].items():
                named = {n: torch.as_tensor(m) for n, m in moments.items()}
                found |= {f"{part}/{at}/{name}": tensor for name, tensor in named.items()}
        _, variables = self.model._get_torch_save_params()
        found |= {f"variable/{name}": getattr(self.model, name).detach() for name in variables}
        return {name: tensor.detach().clone() for name, tensor in found.items()}

    def _replay(self) -> dict[str, torch.Tensor] | None:
        """Return the transitions of an off-policy learner, oldest first; None of another."""
        buffer = getattr(self.model, "replay_buffer", None)
        if not isinstance(self.model, OffPolicyAlgorithm) or buffer is None:
            return None
        begin = buffer.pos if buffer.full else 0
        order = (np.arange(buffer.size()) + begin) % buffer.buffer_size
        return {
            name: torch.from_numpy(getattr(buffer, column)[order, 0])
            for name, column in _COLUMNS.items()
        }

    def _restore(self, saved: Checkpoint, state: State) -> None:
        held, replay = saved.part("sb3"), saved.part("replay")
        try:
            self._load(held)
            if (own := self._replay()) is not None:
                rows = state.replay_added
                require_equal_layout(
                    replay, {n: t.new_zeros((rows, *t.shape[1:])) for n, t in own.items()}
                )
                self._refill(replay, rows)
        except (ValueError, KeyError, RuntimeError) as error:
            raise CheckpointError(f"{saved.path}: its state is not valid: {error}") from error

    def _load(self, held: Mapping[str, torch.Tensor]) -> None:
        """Load what ``_held`` returned."""
        parameters: dict[str, Any] = dict(self.model.get_parameters())
        optimisers = {n for n, state in parameters.items() if "param_groups" in state}
        moments: dict[str, dict[int, dict[str, torch.Tensor]]] = {n: {} for n in optimisers}
        weights = {}
        for name, tensor in held.items():
            part, _, rest = name.partition("/")
            if part in optimisers:
                at, _, moment = rest.partition("/")
                moments[part].setdefault(int(at), {})[moment] = tensor
            else:
                weights[name] = tensor
        expected = {n: t for n, t in self._held().items() if n.partition("/")[0] not in optimisers}
        require_equal_layout(weights, expected)
        for part, state in parameters.items():
            own = {n.partition("/")[2]: t for n, t in weights.items() if n.startswith(f"{part}/")}
            parameters[part] = {**state, "state": moments[part]} if part in optimisers else own
        self.model.set_parameters(parameters, exact_match=True)
        for name, tensor in weights.items():
            part, _, variable = name.partition("/")
            if part == "variable":
                getattr(self.model, variable).data.copy_(tensor)

    def _refill(self, replay: Mapping[str, torch.Tensor], rows: int) -> None:
        buffer: Any = self.model.replay_buffer  # type: ignore[attr-defined]
        if rows > buffer.buffer_size:
            raise ValueError(f"{rows} transitions are more than buffer_size")
        for name, column in _COLUMNS.items():
            getattr(buffer, column)[:rows, 0] = replay[name].numpy()
        buffer.pos, buffer.full = rows % buffer.buffer_size, rows == buffer.buffer_size


_COLUMNS = {
    "observation": "observations",
    "next_observation": "next_observations",
    "action": "actions",
    "reward": "rewards",
    "done": "dones",
    "timeout": "timeouts",
}
"""Names of the replay's tensors in a checkpoint → arrays of the buffer."""


_LOSSES = "loss", "critic_loss", "value_loss"
"""Names of the loss that the run reports, the first that the algorithm has."""


class _Following(BaseCallback):
    """Counts decisions and does what is due between episodes."""

    def __init__(
        self, trainer: Sb3Trainer, collector: InProcessCollector, stop: Callable[[], bool]
    ) -> None:
        super().__init__()
        self._trainer, self._collector, self._stop = trainer, collector, stop
        self.stopped = False
        self._before = trainer.progress.decision
        self._between = False
        self._budget, self._ends = trainer.config.train.decisions, 0

    def _on_step(self) -> bool:
        """Return False once the budget is spent, or the run is to stop after an episode.

        A rollout that ends with the budget goes on to its update.

        The algorithm stores a transition after this call. What is due between two episodes is done
        in the first call of the next one, whose first decision then counts as none if the run
        stops.
        """
        progress = self._trainer.progress
        if self._between:
            going = self._trainer.validate_or_save(self._collector, self._before)
            self._before, self._between = progress.decision, False
            self.stopped = not going or self._stop()
            if self.stopped:
                return False
        progress.decision += 1
        self.count()
        if self.locals["dones"][0]:
            self._trainer.end_episode(self.locals["infos"][0])
            self._between = True
        return progress.decision < self._budget or progress.decision == self._ends

    def count(self) -> None:
        """Take over the algorithm's number of updates and its loss."""
        logged, progress = self.model.logger.name_to_value, self._trainer.progress
        progress.updates = int(getattr(self.model, "_n_updates", 0))
        progress.loss = next((logged[f"train/{n}"] for n in _LOSSES if f"train/{n}" in logged), 0.0)

    def _on_training_start(self) -> None:
        self._fit_rollout()

    def _on_rollout_end(self) -> None:
        self._fit_rollout()

    def _fit_rollout(self) -> None:
        """Let the last rollout end with the budget, so that the policy learns from all of it.

        A single decision, whose advantage cannot be scaled, belongs to the rollout before it.
        """
        left = self._budget - self._trainer.progress.decision
        if isinstance(self.model, OnPolicyAlgorithm) and 1 < left <= self.model.n_steps + 1:
            self.model.n_steps = left

    def _on_rollout_start(self) -> None:
        if isinstance(self.model, OnPolicyAlgorithm):
            buffer, steps = self.model.rollout_buffer, self.model.n_steps
            self._ends = self._trainer.progress.decision + steps
            if buffer.buffer_size != steps:
                buffer.buffer_size = steps
                buffer.reset()
