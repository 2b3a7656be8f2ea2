"""The composed configuration as frozen pydantic models.

In: plain containers, through ``resolver.parse``. Out: validated models with plugin instances
inside. The sections and their settings are defined in ``sections``. A policy can be evaluated
without the plugins of its training's terrain and rewards: ``with_stand_ins`` replaces them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, cast

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

from flipperctl.api import (
    NAME_RULE,
    SAMPLE_PERIOD,
    Engine,
    Learner,
    Logger,
    Network,
    Plugin,
    RewardTerm,
    Robot,
    Sensor,
    Settings,
    Shaping,
    Terrain,
    Training,
    Transition,
    is_plugin_name,
    registry,
)
from flipperctl.config.resolver import create, loggers_by_name, named_robot, to_dict
from flipperctl.config.sampled import Randomise, check_ranges, replace_settings, sample
from flipperctl.config.sections import (
    Episode,
    Eval,
    LocalCollector,
    RayCollector,
    Train,
)
from flipperctl.config.teacher import Teacher
from flipperctl.core.targets import ActionKind, Flippers
from flipperctl.errors import ConfigError, PluginError
from flipperctl.text.messages import close_match, missing_plugin


def _plugin(kind: str) -> tuple[BeforeValidator, PlainSerializer]:
    """Return what reads and writes the plugin of the section ``kind``."""
    return BeforeValidator(partial(_read, kind)), PlainSerializer(to_dict)


def _read(kind: str, value: object) -> Any:
    default = _DEFAULTS.get(kind)
    if default and isinstance(value, Mapping) and "name" not in value:
        value = {"name": default, **value}
    return create(kind, value, kind)


def _rewards(value: object) -> object:
    if not isinstance(value, Mapping):
        raise ConfigError(f"rewards: a mapping of terms is allowed; got {value!r}")
    return _by_name("reward", "rewards", value, "term", "known", "a new one needs a name")


def _loggers(value: object) -> object:
    named = loggers_by_name(value)
    if not isinstance(named, Mapping):
        raise ConfigError(f"logger: names, or a mapping of loggers, are allowed; got {value!r}")
    loggers = _by_name("logger", "logger", named, "logger", "chosen", "logger={} chooses it")
    for key in loggers:
        if not is_plugin_name(key):  # it also names the logger's folder
            raise ConfigError(f"logger.{key}: {NAME_RULE}")
    return loggers


def _by_name(
    kind: str, section: str, value: Mapping[Any, Any], noun: str, known: str, advice: str
) -> dict[str, Any]:
    """Return the plugins of a section; fields of an entry that is missing are refused."""
    # An entry without a name changes one that is there; what is left over changes nothing.
    complete = [str(k) for k, v in value.items() if not isinstance(v, Mapping) or "name" in v]
    for key in map(str, value):
        if key not in complete:
            raise ConfigError(
                f"{section}.{key}: there is no such {noun}{close_match(key, complete)}; "
                f"{known}: {', '.join(complete) or 'none'}; {advice.format(key)}"
            )
    return {str(k): create(kind, v, f"{section}.{k}") for k, v in value.items()}


def _to_dicts(value: Mapping[str, Plugin]) -> dict[str, Any]:
    return {name: to_dict(plugin) for name, plugin in value.items()}


ConfiguredTerrain = Annotated[Terrain, *_plugin("terrain")]
NamedRobot = Annotated[
    Robot, BeforeValidator(lambda value: named_robot(value) if isinstance(value, str) else value)
]
AnyNetwork = Annotated[Network, *_plugin("network")]
AnyLearner = Annotated[Learner, *_plugin("agent")]
AnyEngine = Annotated[Engine, *_plugin("sim")]
AnySensor = Annotated[Sensor, *_plugin("perception")]
AnyRewards = Annotated[dict[str, RewardTerm], BeforeValidator(_rewards), PlainSerializer(_to_dicts)]
AnyLoggers = Annotated[dict[str, Logger], BeforeValidator(_loggers), PlainSerializer(_to_dicts)]

DEFAULT_ENGINE = "planar"
"""Name of the default engine and of the default sensor."""
DEFAULT_LEARNER = "d3qn"
DEFAULT_LOGGER = "tensorboard"
_DEFAULTS = {"sim": DEFAULT_ENGINE, "perception": DEFAULT_ENGINE, "agent": DEFAULT_LEARNER}
"""Kind of plugin → name of the plugin whose settings a section without a name has."""
PAPER_REWARDS = {"flipper": "flipper", "pitch": "pitch", "end": "end"}


def default_engine(flippers: Flippers) -> str:
    """Return the name of the default engine, or of the first other one that moves ``flippers``."""
    engines: dict[str, Any] = {name: cls for (kind, name), cls in registry.items() if kind == "sim"}
    names = [DEFAULT_ENGINE, *sorted(engines)]
    return next(name for name in names if flippers in engines[name].flippers)


class EnvConfig(Settings):
    """The configuration of an environment."""

    terrain: ConfiguredTerrain = Field(description="the ground [-]")
    rewards: AnyRewards = Field(
        # the validator turns names into terms
        default_factory=lambda: cast("dict[str, RewardTerm]", dict(PAPER_REWARDS)),
        description="the terms of the reward: a preset, and rewards.NAME=NAME for one more [-]",
    )
    robot: NamedRobot = Robot()
    sim: AnyEngine = Field(
        default_factory=lambda: cast("Engine", DEFAULT_ENGINE), description="the engine [-]"
    )
    perception: AnySensor = Field(
        default_factory=lambda: cast("Sensor", DEFAULT_ENGINE), description="the ground sensor [-]"
    )
    episode: Episode = Episode()
    randomise: Randomise = Randomise()

    @model_validator(mode="after")
    def _follow_flippers(self) -> EnvConfig:
        """Let the observation have the robot's flippers, which the engine must be able to move."""
        flippers, movable = self.robot.flippers, type(self.sim).flippers
        if flippers not in movable:
            raise ConfigError(
                f"robot.flippers: sim={self.sim.plugin_name} moves {' and '.join(movable)} alone, "
                f"not {flippers}; sim=mujoco moves each flipper"
            )
        if self.perception.flippers != flippers:
            sensor = self.perception.model_copy(update={"flippers": flippers})
            self.__dict__["perception"] = sensor  # a frozen model sets no attribute
        return self

    @model_validator(mode="after")
    def _check_decisions(self) -> EnvConfig:
        """Refuse decisions shorter than a sample period, and delays longer than a decision."""
        check_ranges(self._sampled_sections, self.randomise)
        # Decisions need one sample of the pitch at least, and time for the longest delay.
        period = self.robot.decision_period
        if period < SAMPLE_PERIOD:
            is_set = self.robot.control_period is not None
            cause = "control_period:" if is_set else "angle_step: angle_step / flipper_speed,"
            raise ConfigError(
                f"robot.{cause} a decision would take {period:.3g} s; at least "
                f"{SAMPLE_PERIOD:g} s, the sampling time of the pitch, is allowed"
            )
        for section, name in (("robot", "actuator_delay"), ("perception", "delay")):
            longest, key = getattr(getattr(self, section), name), f"{section}.{name}"
            if sampled := self.randomise.find(section, name):
                longest, key = sampled.ends[1], sampled.key
            if longest > period:
                raise ConfigError(f"{key}: {longest:g} s is longer than a decision, {period:g} s")
        return self

    @model_validator(mode="after")
    def _check_episode(self) -> EnvConfig:
        """Refuse a start angle beyond the limit, and a rule by which every robot is stuck."""
        # The start must be possible.
        robot, episode = self.robot, self.episode
        if abs(episode.start_angle) > robot.angle_limit:
            raise ConfigError(
                f"episode.start_angle: {episode.start_angle:g} rad is beyond robot.angle_limit, "
                f"{robot.angle_limit:g} rad"
            )

        # The slowest sampled robot must be able to make the progress of the rule.
        sampled = self.randomise.find("robot", "track_speed")
        slowest = sampled.ends[0] if sampled else robot.track_speed
        window = episode.stuck_decisions(robot.decision_period)
        farthest = slowest * window * robot.decision_period
        if episode.stuck_progress > farthest:
            raise ConfigError(
                f"episode.stuck_progress: {episode.stuck_progress:g} m in {window} "
                f"decisions is more than a robot of {slowest:g} m/s drives on level ground; at "
                f"most {farthest:.3g} m is allowed, or every robot is stuck"
            )
        return self

    @property
    def _sampled_sections(self) -> dict[str, Settings]:
        return {"sim": self.sim, "robot": self.robot, "perception": self.perception}

    def sample(self, rng: np.random.Generator) -> dict[str, float]:
        """Sample a value of each randomised setting, by name in SI units; a switch is 1 or 0."""
        return sample(self._sampled_sections, self.randomise, rng)

    def with_sampled_values(self, values: Mapping[str, float]) -> tuple[Engine, Robot, Sensor]:
        """Return the engine, robot and sensor of an episode with the sampled ``values``."""
        # The policy decides as often as for the configured robot, however fast the flippers turn.
        sections = replace_settings(self._sampled_sections, values)
        robot = sections["robot"]
        if robot != self.robot:
            robot = robot.model_copy(update={"control_period": self.robot.decision_period})
        return sections["sim"], robot, sections["perception"]

    def environment(self) -> EnvConfig:
        """Return the part of the configuration that defines the environment."""
        return EnvConfig(**{name: getattr(self, name) for name in EnvConfig.model_fields})


class EvalConfig(EnvConfig):
    """The configuration of an evaluation: environment, episodes and the conditions' name."""

    conditions: str = Field(
        "nominal", description="name of the conditions to which overrides were applied [-]"
    )
    eval: Eval = Eval()


class TrainConfig(EnvConfig):
    """The complete configuration of a training run."""

    actions: ActionKind = Field(
        "turns",
        description="turns: each joint turns by an angle step or holds in a decision; rates: any "
        "turn up to that, which needs a learner of continuous actions [-]",
    )
    network: AnyNetwork = Field(description="the network of the policy [-]")
    agent: AnyLearner = Field(
        default_factory=lambda: cast("Learner", DEFAULT_LEARNER), description="the learner [-]"
    )
    train: Train = Train()
    collector: LocalCollector | RayCollector = Field(
        LocalCollector(), discriminator="name", description="where training episodes are played [-]"
    )
    teacher: Teacher = Teacher()
    eval: Eval = Eval()
    logger: AnyLoggers = Field(
        default_factory=lambda: cast("dict[str, Logger]", {DEFAULT_LOGGER: DEFAULT_LOGGER}),
        description="what records a training's numbers [-]",
    )
    seed: int = Field(1, ge=0, le=2**63 - 1, description="seed of all randomness [-]")
    device: str = Field("cpu", description="torch device of the learner, such as cpu or cuda [-]")

    @model_validator(mode="before")
    @classmethod
    def _check_learner_first(cls, values: Any) -> Any:
        # Rewards and the teacher repeat its discount: an error names the key that was typed.
        if isinstance(values, Mapping) and "agent" in values:
            return {**values, "agent": _read("agent", values["agent"])}
        return values

    @model_validator(mode="after")
    def _check(self) -> TrainConfig:
        for fault in (*self._faults(), *self._faults_of_rewards()):
            raise ConfigError(fault)
        try:
            self.agent.check(self)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        return self

    def _faults(self) -> Iterator[str]:
        """Yield what the learner does not go with, by what it says of itself."""
        agent, name = self.agent, f"agent={self.agent.plugin_name}"
        if self.teacher.teaches and not agent.takes_teacher:
            yield f"teacher: {name} learns from rewards alone; set teacher=none"
        if self.train.record and (agent.own_loop or self.actions == "rates"):
            yield f"train.record: it does not go with {name} actions={self.actions}; leave it out"
        if self.train.mode == "exact" and self.collector.name != "local":
            yield (
                "train.mode: exact plays episodes in the learner's process; "
                f"collector={self.collector.name} needs train.mode=fast"
            )

    def _faults_of_rewards(self) -> Iterator[str]:
        if not any(term.weight for term in self.rewards.values()):
            yield (
                "rewards: a training needs a term whose weight is not 0 (terms: "
                f"{', '.join(self.rewards) or 'none'}); add one with "
                "rewards.pitch=pitch, or leave the rewards as they are"
            )

        # Shaping leaves the optimal policy as it is only with the learner's own discount.
        gamma = self.agent.gamma
        for name, term in self.rewards.items():
            if isinstance(term, Shaping) and term.gamma != gamma:
                yield (
                    f"rewards.{name}.gamma: {term.gamma} is not agent.gamma ({gamma}); the "
                    "shaping would change the optimal policy; set "
                    f"rewards.{name}.gamma={gamma}"
                )


Files = Mapping[tuple[str, str], str | Path]
"""(kind, name) of a plugin → the name of the file that it came from, or the path of a copy."""


class _Absent:
    """What stands in for a plugin that is missing, with any settings."""

    model_config = ConfigDict(extra="allow")
    missing: ClassVar[str]
    """What is missing, and how to get it."""


class AbsentTerrain(Terrain, _Absent):
    """Keep the settings of a terrain if its plugin, or the plugin of an inner one, is missing."""

    def generate(self, rng: np.random.Generator) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)


class AbsentReward(RewardTerm, _Absent):
    """Keep the settings of a reward term whose plugin is missing."""

    def __call__(self, t: Transition) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)


class AbsentLearner(Learner, _Absent):
    """Keep the settings of a learner whose plugin is missing."""

    takes_teacher: ClassVar[bool] = True

    @property
    def drives(self) -> tuple[ActionKind, ...]:
        """Any kind: the policy exists."""
        return "turns", "rates"

    def build(self, training: Training) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)

    def drive(self, *arguments: object) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)


def with_stand_ins(settings: Mapping[str, Any], files: Files) -> dict[str, Any]:
    """Return a plain configuration with stand-ins where terrain, reward or learner are missing.

    A missing teacher's controller and missing loggers are left out, since only a training needs
    them.
    """
    # What acts in an evaluation gets a stand-in that says what is missing.
    result = dict(settings)
    result["terrain"] = _or_stand_in(AbsentTerrain, settings["terrain"], files)
    if "rewards" in settings:
        terms = settings["rewards"]
        result["rewards"] = {k: _or_stand_in(AbsentReward, v, files) for k, v in terms.items()}
    if "name" in (agent := settings.get("agent") or {}):
        result["agent"] = _or_stand_in(AbsentLearner, agent, files)

    # What only a training uses is left out.
    teacher = settings.get("teacher") or {}
    if any(_missing_names("controller", teacher.get("controller"))):
        result["teacher"] = {**teacher, "controller": None}
    if loggers := settings.get("logger"):
        result["logger"] = {
            k: v for k, v in loggers.items() if not any(_missing_names("logger", v))
        }
    return result


def _or_stand_in(
    family: type[AbsentTerrain | AbsentReward | AbsentLearner], settings: Any, files: Files
) -> Any:
    """Return the settings, or a stand-in if a plugin that they name is missing."""
    kind = family.kind
    name = next(_missing_names(kind, settings), None)
    if name is None:
        return settings
    text = missing_plugin(kind, name, files.get((kind, name)))
    fields = dict(settings)
    # A class of its own for each plugin, since the name of a plugin belongs to its class.
    attributes: dict[str, Any] = {"plugin_name": fields.pop("name"), "missing": text}
    stand_in = type(family.__name__, (family,), {**attributes, "__module__": __name__})
    return stand_in(**fields)


def _missing_names(kind: str, settings: Any) -> Iterator[str]:
    """Yield the names of missing plugins in the settings of a plugin, at any depth."""
    if isinstance(settings, Mapping):
        name = settings.get("name")
        if isinstance(name, str) and (kind, name) not in registry:
            yield name
        settings = settings.values()
    elif not isinstance(settings, list | tuple):
        return
    for inner in settings:
        yield from _missing_names(kind, inner)
