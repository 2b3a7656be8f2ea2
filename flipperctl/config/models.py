"""The composed configuration as frozen pydantic models.

In: plain containers (from Hydra, a checkpoint or keyword arguments). Out: validated models with
plugin instances inside. The sections and their settings stand in ``sections``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, cast

from pydantic import BeforeValidator, Field, PlainSerializer, ValidationError, model_validator
from pydantic_core import PydanticSerializationError

from flipperctl import plugins
from flipperctl.api import (
    Engine,
    Network,
    RewardTerm,
    Robot,
    Sensor,
    Settings,
    Shaping,
    Terrain,
)
from flipperctl.config.randomise import Randomise, replaced
from flipperctl.config.sections import (
    Agent,
    Episode,
    Eval,
    LocalCollector,
    RayCollector,
    Train,
)
from flipperctl.errors import ConfigError, FlipperctlError
from flipperctl.messages import close_match, explain


def _terrain(value: object) -> object:
    return plugins.create("terrain", value, "terrain")


def _network(value: object) -> object:
    return plugins.create("network", value, "network")


def _engine(value: object) -> object:
    return plugins.create("sim", _named(value), "sim")


def _sensor(value: object) -> object:
    return plugins.create("perception", _named(value), "perception")


def _named(value: object) -> object:
    """The settings with a name; files of version 0.1 have none."""
    if isinstance(value, Mapping) and "name" not in value:
        return {"name": DEFAULT_ENGINE, **value}
    return value


def _rewards(value: object) -> object:
    if not isinstance(value, Mapping):
        raise ConfigError(f"rewards: a mapping of terms is allowed; got {value!r}")
    complete = [str(k) for k, v in value.items() if not isinstance(v, Mapping) or "name" in v]
    for key in value:
        if str(key) not in complete:  # a field of a term that is not there
            raise ConfigError(
                f"rewards.{key}: there is no such term{close_match(str(key), complete)}; "
                f"known: {', '.join(complete)}; a new one needs a name"
            )
    return {str(k): plugins.create("reward", v, f"rewards.{k}") for k, v in value.items()}


def _reward_containers(value: Mapping[str, RewardTerm]) -> dict[str, Any]:
    return {name: plugins.container(term) for name, term in value.items()}


ConfiguredTerrain = Annotated[
    Terrain, BeforeValidator(_terrain), PlainSerializer(plugins.container)
]
AnyNetwork = Annotated[Network, BeforeValidator(_network), PlainSerializer(plugins.container)]
AnyEngine = Annotated[Engine, BeforeValidator(_engine), PlainSerializer(plugins.container)]
AnySensor = Annotated[Sensor, BeforeValidator(_sensor), PlainSerializer(plugins.container)]
AnyRewards = Annotated[
    dict[str, RewardTerm], BeforeValidator(_rewards), PlainSerializer(_reward_containers)
]

DEFAULT_ENGINE = "planar"
"""Name of the engine and of the sensor that are used if none is chosen."""
PAPER_REWARDS = {"flipper": "flipper", "pitch": "pitch", "end": "end"}


class EnvConfig(Settings):
    """Everything the environment is made of."""

    terrain: ConfiguredTerrain
    rewards: AnyRewards = Field(
        # names, which the validator turns into terms
        default_factory=lambda: dict(PAPER_REWARDS)  # type: ignore[arg-type]
    )
    robot: Robot = Robot()
    sim: AnyEngine = Field(default_factory=lambda: cast("Engine", DEFAULT_ENGINE))
    perception: AnySensor = Field(default_factory=lambda: cast("Sensor", DEFAULT_ENGINE))
    episode: Episode = Episode()
    randomise: Randomise = Randomise()

    @model_validator(mode="after")
    def _draws_are_allowed(self) -> EnvConfig:
        for section, name, ends in self.randomise.ranges():
            settings = getattr(self, section)
            model = type(settings)
            if name not in model.model_fields:
                raise ConfigError(
                    f"randomise.{name}: {section}={settings.plugin_name} has no setting {name!r}; "
                    f"drop it with randomise.{name}=null"
                )
            for value in ends:
                try:
                    model(**{name: value})
                except ValidationError as error:
                    raise ConfigError(explain(error, "randomise", model)) from error
        for section, name in (("robot", "actuator_delay"), ("perception", "delay")):
            longest = max(
                getattr(getattr(self, section), name), *(getattr(self.randomise, name) or (0,))
            )
            if longest > self.robot.decision_period:
                raise ConfigError(
                    f"{section}.{name}: {longest:g} s is longer than a decision, "
                    f"{self.robot.decision_period:g} s"
                )
        return self

    def drawn(self, values: Mapping[str, float]) -> tuple[Engine, Robot, Sensor]:
        """Engine, robot and perception of an episode in which ``values`` were drawn."""
        sections = {"sim": self.sim, "robot": self.robot, "perception": self.perception}
        found = replaced(sections, values)
        return found["sim"], found["robot"], found["perception"]

    def environment(self) -> EnvConfig:
        """The part that the environment is made of."""
        return EnvConfig(**{name: getattr(self, name) for name in EnvConfig.model_fields})


class EvalConfig(EnvConfig):
    """An evaluation: the environment, how often, and what its conditions are called."""

    conditions: str = Field(
        "nominal", description="the named conditions that overrides were laid over [-]"
    )
    eval: Eval = Eval()


class TrainConfig(EnvConfig):
    """A training run, complete."""

    network: AnyNetwork
    agent: Agent = Agent()
    train: Train = Train()
    collector: LocalCollector | RayCollector = Field(LocalCollector(), discriminator="name")
    eval: Eval = Eval()
    seed: int = Field(1, ge=0, le=2**63 - 1, description="seed of everything random [-]")
    device: str = Field("cpu", description="torch device of the learner, such as cpu or cuda [-]")

    @model_validator(mode="after")
    def _one_place_to_play(self) -> TrainConfig:
        if self.train.mode == "exact" and self.collector.name != "local":
            raise ConfigError(
                "train.mode: exact plays in the learner's process; "
                f"collector={self.collector.name} needs train.mode=fast"
            )
        return self

    @model_validator(mode="after")
    def _something_is_paid(self) -> TrainConfig:
        if not any(term.weight for term in self.rewards.values()):
            there = ", ".join(self.rewards) if self.rewards else "none"
            raise ConfigError(
                f"rewards: a training needs a term whose weight is not 0 (terms: {there}); add one "
                "with +reward@rewards.pitch=pitch, or leave rewards=paper as it is"
            )
        return self

    @model_validator(mode="after")
    def _shaping_changes_no_policy(self) -> TrainConfig:
        agent = self.agent
        for name, term in self.rewards.items():
            if not isinstance(term, Shaping):
                continue
            if term.gamma != agent.gamma:
                raise ConfigError(
                    f"rewards.{name}.gamma: {term.gamma} is not agent.gamma ({agent.gamma}); the "
                    "shaping would change which policy is best; set "
                    f"rewards.{name}.gamma={agent.gamma}"
                )
            if agent.bootstrap_outcomes:
                raise ConfigError(
                    f"agent.bootstrap_outcomes: the shaping rewards.{name} ends with the episode, "
                    f"so the value must too; set agent.bootstrap_outcomes=[] or drop the term with "
                    f"~rewards.{name}"
                )
        return self


ConfigT = TypeVar("ConfigT", bound=Settings)


def parse(model: type[ConfigT], container: Mapping[str, Any]) -> ConfigT:
    """Validate a composed container.

    Raises:
        ConfigError: one line with the configuration path, the value and what is allowed.
    """
    try:
        return model(**container)
    except ValidationError as error:
        raise ConfigError(explain(error, "", model)) from error


def container(config: Settings) -> dict[str, Any]:
    """The plain container from which ``parse`` makes an equal configuration.

    Raises:
        PluginError: a plugin in it cannot be written as JSON.
    """
    try:
        return config.model_dump(mode="json")
    except PydanticSerializationError as error:
        if isinstance(error.__cause__, FlipperctlError):  # pydantic wraps what a plugin raises
            raise error.__cause__ from error
        raise


def merged(config: Settings, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """The container of ``config`` with nested or dotted overrides laid over it.

    A reward term set to None is dropped, and so are all by an empty mapping of rewards.
    """
    result = container(config)
    for key, value in overrides.items():
        if key == "rewards" and value == {}:  # nothing to lay over what is there
            result[key] = {}
            continue
        *parents, leaf = key.split(".")
        node = result
        for parent in parents:
            node = node.setdefault(parent, {})
            if not isinstance(node, dict):
                raise ConfigError(f"{key}: {parent} is a value, no section; it is {node!r}")
        _lay_over(node, leaf, value)
    if isinstance(rewards := result.get("rewards"), dict):
        result["rewards"] = {name: term for name, term in rewards.items() if term is not None}
    return result


def _lay_over(node: dict[str, Any], key: str, value: Any) -> None:
    old = node.get(key)
    if isinstance(old, dict) and isinstance(value, Mapping) and "name" not in value:
        for inner, item in value.items():
            _lay_over(old, inner, item)
    else:  # a copy, since a later override may lie inside it
        node[key] = dict(value) if isinstance(value, Mapping) else value
