"""Training by a learner of Stable-Baselines3 (``agent=sb3``); only this module imports it.

In: a configuration. Out: a run like that of our own learners: seeded episodes, validations,
metrics, checkpoints without pickles. The policy is a ``network=mlp`` of the same widths, so that
evaluation, export and robots need no Stable-Baselines3.
"""

from __future__ import annotations

import inspect
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np
import torch
from torch import nn

from flipperctl.api import Learning, Loop, Step, Training
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.config.describe import Field
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, missing_extra
from flipperctl.text.messages import close_match

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
except ImportError as error:
    raise missing_extra("agent=sb3", "stable-baselines3") from error

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


class Request(NamedTuple):
    """An algorithm with the arguments of its class."""

    algorithm: str
    settings: Mapping[str, Any]
    gamma: float


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

    def __init__(self, env: FlipperEnv) -> None:
        super().__init__(env)
        self.loop: Loop | None = None
        """The run, once it trains."""
        self.seed, self.difficulty = 0, 1.0

    def reset(self, **ignored: Any) -> Any:
        """Begin the next training episode."""
        assert self.loop is not None  # the algorithm resets when it begins to learn
        self.seed, self.difficulty = self.loop.begin_episode()
        return self.env.reset(seed=self.seed, options={"difficulty": self.difficulty})


def arguments(algorithm: str, defaults: Mapping[str, Any]) -> Iterator[Field]:
    """Yield the arguments that ``agent.settings`` takes, as the library describes them.

    The signature of its class gives the types, its docstring the bounds.
    """
    # Types alone say little: bounds are read from the docstring, a text for each parameter.
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
        default = defaults.get(name, parameter.default)
        yield Field(name, str(parameter.annotation), default, bounds, "", text)


def check_settings(method: Request, config: TrainConfig) -> None:
    """Refuse arguments that the algorithm does not take, or that settings of the run replace."""
    cls = _class_of(method.algorithm)
    parameters = inspect.signature(cls).parameters
    known = {argument.name: argument for argument in arguments(method.algorithm, {})}
    # Each argument by itself: whose it is, whether it exists, its type and its bounds.
    for name, value in method.settings.items():
        where = f"agent.settings.{name}"
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
    # Evaluation and export rebuild network=mlp, so that no other architecture can be trained.
    policy = method.settings.get("policy_kwargs") or {}
    for name in policy if isinstance(policy, dict) else ():
        if name in _ARCHITECTURE:
            raise ConfigError(
                f"agent.settings.policy_kwargs.{name}: the network is network=mlp; "
                "network.hidden sets its widths"
            )
    # What is left to the library's own checks appears when it builds the algorithm.
    with _own_generators(config.seed):
        _model(method, config, FlipperEnv(config=config.environment(), actions=config.actions))


def _class_of(algorithm: str) -> type[BaseAlgorithm]:
    cls: type[BaseAlgorithm] = getattr(stable_baselines3, algorithm.upper())
    return cls


def _model(method: Request, config: TrainConfig, env: gymnasium.Env[Any, Any]) -> BaseAlgorithm:
    """Return the algorithm with an untrained policy."""
    arguments: dict[str, Any] = dict(method.settings)
    # JSON has neither schedules, tuples nor noise: translate them.
    rate = arguments.get("learning_rate")
    if isinstance(rate, list):
        arguments["learning_rate"] = LinearSchedule(rate[0], rate[1], 1.0)
    if isinstance(arguments.get("train_freq"), list):
        arguments["train_freq"] = tuple(arguments["train_freq"])
    if (noise := arguments.get("action_noise")) is not None:
        arguments["action_noise"] = NormalActionNoise(
            *(np.full(len(config.robot.joints), size) for size in (0.0, float(noise)))
        )
    # The layers of network=mlp, so that its module takes over their weights one by one.
    hidden: Sequence[int] = cast("Any", config.network).hidden
    policy = {
        **(arguments.pop("policy_kwargs", None) or {}),
        "net_arch": list(hidden),
        "activation_fn": nn.LeakyReLU,
        "features_extractor_class": Scaled,
        "features_extractor_kwargs": {"scale": tuple(config.perception.scale.tolist())},
    }
    cls, gamma = _class_of(method.algorithm), method.gamma
    arguments |= {"policy_kwargs": policy, "gamma": gamma, "device": config.device}
    # Its constructors check by many exceptions; each becomes an error of the setting.
    try:
        model = cls("MlpPolicy", env, **arguments)
    except (TypeError, ValueError, AssertionError, IndexError, MemoryError) as error:
        raise ConfigError(f"agent.settings: {cls.__name__} refuses them: {error}") from error
    # The run reports; the library's own printing is off.
    model.set_logger(Logger(None, []))
    if config.actions == "rates" and isinstance(
        head := getattr(model.policy, "action_net", None), nn.Linear
    ):
        model.policy.action_net = nn.Sequential(head, nn.Tanh())  # the mean of PPO and A2C
    return model


def _layers(model: BaseAlgorithm) -> list[nn.Linear]:
    """Return the linear layers from an observation to Q-values, logits or rates."""
    policy: Any = model.policy
    # DQN, then PPO and A2C, then SAC, TD3 and DDPG, which name their layers differently.
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


class Sb3Learning(Learning):
    """A run by a learner of Stable-Baselines3."""

    def __init__(self, method: Request, training: Training) -> None:
        # The library takes one whole number of 32 bits as its seed.
        (word,) = np.random.SeedSequence(training.config.seed).generate_state(1).tolist()
        self._seed, self._training = word, training
        self.budget = training.decisions
        """Decisions of the run."""
        self._report = training.report
        self._network = self.driving = training.policy_network()
        self._episodes = _Episodes(training.environment())
        with _own_generators(word):
            self.model = _model(method, training.config, self._episodes)

    @property
    @torch.no_grad()
    def policy(self) -> nn.Module:  # type: ignore[override]  # made anew from the library's
        """Our network with the weights of the library's."""
        layers = [m for m in self._network.modules() if isinstance(m, nn.Linear)]
        for layer, source in zip(layers, _layers(self.model), strict=True):
            layer.load_state_dict({name: t.cpu() for name, t in source.state_dict().items()})
        return self._network

    def exploration(self, decision: int) -> float | None:
        """Return ε of DQN."""
        return getattr(self.model, "exploration_rate", None)

    def add(self, step: Step, decision: int) -> None:
        """Do nothing: the algorithm plays the episodes itself."""

    def train(self, loop: Loop) -> bool:
        """Let the algorithm learn; return False if the run is to stop before the budget's end."""
        budget, done = self.budget, loop.decision
        # The library counts decisions by itself; a resumed run goes on from its number.
        self._episodes.loop, self.model.num_timesteps = loop, done
        following = _Following(self, loop)
        model: Any = self.model
        # The last rollout is shortened to the budget: say what the policy learns from it.
        if isinstance(model, OnPolicyAlgorithm) and 0 < budget - done < model.n_steps:
            end = "learns once, from these alone" if budget - done > 1 else "stays as it is"
            self._report(
                f"train.decisions={budget} leaves less than a rollout of "
                f"agent.settings.n_steps={model.n_steps} decisions, {budget - done}: the policy "
                f"{end}"
            )
        # Its generators are not saved: a resumed part begins with draws of its own.
        seed = (self._seed + done) % 2**32
        self.model.action_space.seed(seed)  # draws the first actions of an off-policy algorithm
        with _own_generators(seed):
            self.model.learn(
                budget - done,
                callback=following,
                log_interval=budget,
                reset_num_timesteps=False,
            )
        # The last update comes after the last callback.
        following.count()
        return not following.stopped

    def ending(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the row of an episode that has ended."""
        episode = {"seed": self._episodes.seed, "difficulty": self._episodes.difficulty}
        return {**episode, "outcome": str(info["outcome"]), **info["metrics"]}

    def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
        """Return weights, moments and replay."""
        replay = self._replay()
        return {"sb3": self._held(), **({} if replay is None else {"replay": replay})}

    def counters(self) -> dict[str, Any]:
        """Return the number of transitions in the replay."""
        replay = self._replay()
        return {"rows": 0 if replay is None else len(replay["reward"])}

    def restore(
        self, tensors: Mapping[str, Mapping[str, torch.Tensor]], counters: Mapping[str, Any]
    ) -> None:
        """Restore weights, moments and replay."""
        # Weights first: a replay that does not fit then says so by itself.
        self._load(tensors["sb3"])
        if (current := self._replay()) is not None:
            replay, rows = tensors.get("replay", {}), counters["rows"]
            expected = {n: t.new_zeros((rows, *t.shape[1:])) for n, t in current.items()}
            require_equal_layout(replay, expected)
            self._refill(replay, rows)

    def _held(self) -> dict[str, torch.Tensor]:
        """Return the weights and the moments of the optimisers, by names without dots in them."""
        tensors: dict[str, torch.Tensor] = {}
        # Networks have named tensors; an optimiser has moments by the index of a parameter.
        for part, state in self.model.get_parameters().items():
            if "param_groups" not in state:
                tensors |= {f"{part}/{name}": tensor for name, tensor in state.items()}
                continue
            for at, moments in state["state"].items():
                named = {n: torch.as_tensor(m) for n, m in moments.items()}
                tensors |= {f"{part}/{at}/{name}": tensor for name, tensor in named.items()}
        # Tensors outside of networks, such as the logarithm of SAC's entropy coefficient.
        attributes = vars(self.model).items()
        tensors |= {f"variable/{n}": t for n, t in attributes if isinstance(t, torch.Tensor)}
        return {name: tensor.detach().clone() for name, tensor in tensors.items()}

    def _replay(self) -> dict[str, torch.Tensor] | None:
        """Return the transitions of an off-policy learner, oldest first; None of another."""
        buffer = getattr(self.model, "replay_buffer", None)
        if not isinstance(self.model, OffPolicyAlgorithm) or buffer is None:
            return None
        # A full buffer is a ring whose oldest transition lies at its position.
        begin = buffer.pos if buffer.full else 0
        order = (np.arange(buffer.size()) + begin) % buffer.buffer_size
        return {
            name: torch.from_numpy(getattr(buffer, column)[order, 0])
            for name, column in _COLUMNS.items()
        }

    def _load(self, saved: Mapping[str, torch.Tensor]) -> None:
        """Load what ``_held`` returned."""
        # Undo the names of _held: moments by optimiser, parameter and name; all else is weights.
        parameters: dict[str, Any] = dict(self.model.get_parameters())
        optimisers = {n for n, state in parameters.items() if "param_groups" in state}
        moments: dict[str, dict[int, dict[str, torch.Tensor]]] = {n: {} for n in optimisers}
        weights = {}
        for name, tensor in saved.items():
            part, _, rest = name.partition("/")
            if part in optimisers:
                at, _, moment = rest.partition("/")
                moments[part].setdefault(int(at), {})[moment] = tensor
            else:
                weights[name] = tensor
        # The moments exist only after a first update, so that only weights are compared.
        expected = {n: t for n, t in self._held().items() if n.partition("/")[0] not in optimisers}
        require_equal_layout(weights, expected)
        # set_parameters takes whole states; groups and rates of the optimisers stay as built.
        for part, state in parameters.items():
            part_weights = {
                n.partition("/")[2]: t for n, t in weights.items() if n.startswith(f"{part}/")
            }
            parameters[part] = (
                {**state, "state": moments[part]} if part in optimisers else part_weights
            )
        self.model.set_parameters(parameters, exact_match=True)
        # Variables are no part of set_parameters.
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

    def __init__(self, learning: Sb3Learning, loop: Loop) -> None:
        super().__init__()
        self._learning, self._loop = learning, loop
        self.stopped = self._between = False
        self._ends = 0
        """Decision at which the rollout of an on-policy algorithm ends."""

    def _on_step(self) -> bool:
        """Return False once the budget is spent, or the run is to stop after an episode.

        A rollout that ends with the budget goes on to its update.

        The algorithm stores a transition after this call. What is due between two episodes is done
        in the first call of the next one, whose first decision then counts as none if the run
        stops.
        """
        loop, learning = self._loop, self._learning
        if self._between:
            self._between = False
            if not loop.between_episodes():
                self.stopped = True
                return False
        self.count()
        loop.count_decision()
        if self.locals["dones"][0]:
            loop.end_episode(learning.ending(self.locals["infos"][0]))
            self._between = True
        return loop.decision < learning.budget or loop.decision == self._ends

    def count(self) -> None:
        """Take over the algorithm's number of updates and its loss."""
        # The library's losses have names by algorithm, and none before the first update.
        learning, logged = self._learning, self.model.logger.name_to_value
        learning.updates = int(getattr(self.model, "_n_updates", 0))
        losses = (logged[key] for name in _LOSSES if (key := f"train/{name}") in logged)
        learning.loss = next(losses, 0.0)

    def _on_training_start(self) -> None:
        self._fit_rollout()

    def _on_rollout_end(self) -> None:
        self._fit_rollout()

    def _fit_rollout(self) -> None:
        """Let the last rollout end with the budget, so that the policy learns from all of it.

        A single decision, whose advantage cannot be scaled, belongs to the rollout before it.
        """
        left = self._learning.budget - self._loop.decision
        if isinstance(self.model, OnPolicyAlgorithm) and 1 < left <= self.model.n_steps + 1:
            self.model.n_steps = left

    def _on_rollout_start(self) -> None:
        if isinstance(self.model, OnPolicyAlgorithm):
            buffer, steps = self.model.rollout_buffer, self.model.n_steps
            self._ends = self._loop.decision + steps
            # The buffer was built for the length of full rollouts.
            if buffer.buffer_size != steps:
                buffer.buffer_size = steps
                buffer.reset()
