"""Finds policies by their names, and makes picklable references to them.

In: a word, or the name and settings of a controller. Out: the policy. Torch is imported only for a
file of torch's; rules need none. An exported file runs as on the robot, which is checked against
the values that the file applies itself.
"""

from __future__ import annotations

import json
import math
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.api import (
    Controller,
    LearnedValue,
    ObservationLayout,
    Perception,
    Policy,
    Robot,
    Simulator,
)
from flipperctl.api.controllers import plans_on_rewards
from flipperctl.api.plugin import registered_names
from flipperctl.checkpoint import LAST, find, hub, read_policy, shipped_policies
from flipperctl.config import (
    EnvConfig,
    EvalConfig,
    TrainConfig,
    default_engine,
    parse,
    policy_file,
    resolver,
)
from flipperctl.config.models import with_stand_ins
from flipperctl.core.risk import RiskSign
from flipperctl.core.targets import Action, turns
from flipperctl.errors import CheckpointError, ConfigError, PolicyError, RequestError
from flipperctl.plugging.guard import refusal, refusing, short_repr
from flipperctl.policies.controllers import PluginPolicy, plugin_policy
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import Interface

if TYPE_CHECKING:
    from flipperctl.policies.acting import TrainedPolicy

_CLOSE = 1e-6
"""Largest difference of angles, speeds and periods that counts as rounding [SI units]."""
_APPLIED = ("angle_step", "angle_limit", "flipper_speed", "control_period")
"""Settings of a robot that a file applies itself."""


FilePolicy: TypeAlias = "ExportedPolicy | TrainedPolicy"
"""A policy of a file, which acts by a Q-value of each action, on observations alone."""


Takes = Literal["any", "file", "checkpoint", "controller"]
"""What a word may name: any policy, a file's alone, a checkpoint's alone, or a controller."""


def load_policy(
    word: str | os.PathLike[str],
    where: str = "",
    takes: Takes = "any",
    fields: Mapping[str, Any] | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> PolicySource:
    """Return the policy that a word names: the rule of all commands, settings and functions.

    The name of a registered controller means it, though a folder is called so; ``./okada`` is the
    folder. A ``.yaml`` file of ``flipperctl tune`` means its controller with its settings, a folder
    of ``flipperctl drive`` the drives in it. Else the word is a run, a checkpoint or an exported
    file, the name of a shipped policy, or ``hf:user/name[@revision]`` on the Hugging Face Hub.

    A controller has its ``reference_settings``, or the ``fields`` if there are any. ``tell`` is
    called with a line if no validation has chosen the best policy of a run. Errors begin with
    ``where``, the option or setting that holds the word.
    """
    if not isinstance(word, str | os.PathLike):
        raise ConfigError(f"{where}: a path or a name is allowed; the value is {word!r}")
    name, prefix = os.fspath(word), f"{where}: " if where else ""
    # Words that name a controller, or a file of its settings
    known = registered_names("controller") if takes in ("any", "controller") else []
    if name in known:
        reference = resolver.reference(name, where) if fields is None else {"name": name, **fields}
        return PolicySource(
            settings=resolver.to_dict(resolver.create("controller", reference, where))
        )
    if policy_file.is_policy_file(name):
        if takes in ("file", "checkpoint"):
            raise CheckpointError(
                f"{prefix}{name}: a policy file sets a controller; a trained policy is needed"
            )
        stored = policy_file.settings_of(name, where)
        reference = {**stored, **(fields or {}), "name": stored["name"]}
        settings = resolver.to_dict(resolver.create("controller", reference, prefix + name))
        return PolicySource(settings=settings, name=name)

    # Where only a controller will do, anything else is refused by what it is.
    if takes == "controller":
        shared = name in shipped_policies() or name.startswith(hub.PREFIX)
        if shared or os.path.exists(name):  # noqa: PTH110  # of any length
            raise RequestError(
                f"{prefix}controllers are allowed, and {name} is none; name it as a policy beside "
                "the others, which play the same episodes"
            )
        resolver.get("controller", name, where)

    # Whatever else a word may name: a run, a file, a shipped policy, one of the Hub
    try:
        file = find(Path(name), controllers=known)
    except CheckpointError as error:
        named = known and len(Path(name).parts) == 1 and not Path(name).suffix
        raise (ConfigError if named else CheckpointError)(f"{prefix}{error}") from error
    source = PolicySource(checkpoint=file)
    if takes == "checkpoint" and source.is_exported:
        raise CheckpointError(
            f"{prefix}{file}: an exported file holds no training; give its run or checkpoint"
        )
    if Path(name).is_dir() and file == Path(name) / LAST:
        tell(f"{name}: no validation has chosen a best policy yet; this is the last one, {LAST}")
    return source


@dataclass(frozen=True)
class PolicySource:
    """Where a policy comes from: either a file or a controller plugin."""

    checkpoint: Path | None = None
    """A checkpoint, or a file of ``flipperctl export onnx``."""
    settings: dict[str, Any] | None = None
    """``name`` and fields of a controller plugin."""
    name: str = ""
    """Path of the policy file or the drives that the settings are from; empty for none."""

    @property
    def is_exported(self) -> bool:
        """Whether the policy is in an exported file."""
        return self.checkpoint is not None and self.checkpoint.suffix == ".onnx"

    @property
    def file(self) -> Path:
        """The file of a policy that is no controller."""
        assert self.checkpoint is not None
        return self.checkpoint

    def label(self) -> str:
        """Return the name that tables and files use.

        It is the name of a shipped policy or of a controller plugin, ``hf:user/name`` of the Hub,
        otherwise the file's path.
        """
        if self.checkpoint is not None:
            # Names that are the same on every machine go before a path.
            shipped = {file: name for name, file in shipped_policies().items()}
            known = shipped.get(self.checkpoint) or hub.label(self.checkpoint)
            return known or str(self.checkpoint)
        return self.name or str((self.settings or {})["name"])

    @property
    def controller_name(self) -> str | None:
        """Name of the controller plugin; None for a file."""
        return None if self.settings is None else str(self.settings["name"])

    def baselines(self) -> tuple[str, ...]:
        """Return the controllers that this policy is compared with by default."""
        return () if self.checkpoint is not None else self.controller().baselines

    def config(self) -> TrainConfig | EvalConfig:
        """Return the configuration of a file's training; an exported file holds a part of it."""
        if self.is_exported:
            return exported_config(self.file)
        return read_policy(self.file).policy_config()

    def robot(self) -> Robot | None:
        """Return the robot that a file's policy was made for; None for a controller plugin."""
        return None if self.checkpoint is None else self.config().robot

    def build(self, config: EnvConfig) -> Policy:
        """Build the policy for an environment of this configuration, which has to fit a file."""
        if self.checkpoint is None:
            return controller_policy(self.controller(), config)
        return self.build_file(config)

    def build_file(self, config: EnvConfig) -> FilePolicy:
        """Build the policy of a file; see ``build``."""
        # A file of ONNX states its layout, and applies a part of the robot itself.
        if self.is_exported:
            exported = ExportedPolicy(self.file)
            interface = exported.interface
            check_layout(self.file, layout_of(interface), config)
            check_robot(interface, config.robot, self.file)
            return exported

        # A checkpoint has the whole configuration of its training.
        from flipperctl.policies.acting import TrainedPolicy
        from flipperctl.policies.trained import policy_module, policy_risk

        checkpoint = read_policy(self.file)
        trained = checkpoint.policy_config()
        module, risk = policy_module(checkpoint), policy_risk(checkpoint)
        settings = trained.agent.failure_risk
        escape = None if settings is None else settings.escape
        frames, kind, joints = trained.network.frames, trained.actions, len(trained.robot.joints)
        policy = TrainedPolicy(module, frames, risk, escape, kind, joints)
        check_layout(self.file, trained.perception.layout, config)
        return policy

    @property
    def plans_for_rewards(self) -> bool:
        """Whether the policy is a controller that drives for the configured rewards."""
        return self.checkpoint is None and plans_on_rewards(self.controller())

    def notes(self, config: EnvConfig) -> Iterator[str]:
        """Yield what a controller does otherwise than its settings name in this environment."""
        if self.checkpoint is None:
            yield from controller_notes(self.controller(), config)

    def controller(self) -> Controller:
        """Return the controller plugin, for a source without a file."""
        controller = resolver.create("controller", self.settings, "controller")
        assert isinstance(controller, Controller)
        return controller


def controller_policy(
    controller: Controller, config: EnvConfig, path: str = "controller"
) -> PluginPolicy:
    """Return the policy of a controller ``with_files``."""
    return plugin_policy(with_files(controller, config, path), len(config.robot.joints))


def with_files(controller: Controller, config: EnvConfig, path: str = "controller") -> Controller:
    """Return a controller with the files and rewards that it uses, ready to be built.

    ``path``: section of the controller, for errors.
    """
    controller = _copy(controller, "using", _Task(controller.uses(), config, path))
    return _copy(controller, "paying", config.rewards)


def _copy(controller: Controller, hook: str, argument: object) -> Controller:
    """Return the copy that a hook of the controller returns."""
    with refusing(controller, hook, ConfigError):
        result = getattr(controller, hook)(argument)
    if not isinstance(result, Controller):
        text = f"returned {short_repr(result)}; a copy of the controller is allowed"
        raise refusal(controller, hook, text, ConfigError)
    return result


@dataclass(frozen=True)
class _Task:
    """The environment that a controller drives, and the files that its settings name."""

    names: Mapping[str, str]
    config: EnvConfig
    path: str

    def policy(self, setting: str) -> FilePolicy:
        return load_policy(*self._named(setting), "file").build_file(self.config)

    def value(self, setting: str) -> LearnedValue:
        return learned_value(*self._named(setting))

    def _named(self, setting: str) -> tuple[str, str]:
        return self.names[setting], f"{self.path}.{setting}"


def learned_value(name: str, path: str) -> LearnedValue:
    """Return the values of a run, a checkpoint or a shipped policy; ``path``: the setting."""
    from flipperctl.policies.trained import read_value, read_value_once

    file = load_policy(name, path, "checkpoint").file
    # Each policy that is built would read a shipped one again.
    return (read_value_once if file in shipped_policies().values() else read_value)(
        file, name, path
    )


def controller_notes(
    controller: Controller, config: EnvConfig, path: str = "controller"
) -> Iterator[str]:
    """Yield the controller's remarks on an environment; ``path``: its section."""
    yield from controller.remarks(_Task(controller.uses(), config, path))


def check_layout(file: Path, layout: ObservationLayout, config: EnvConfig) -> None:
    """Check that an environment has the observation layout of a policy."""
    if layout != (current := config.perception.layout):
        raise CheckpointError(
            f"{file}: the policy was trained on {layout.words}; perception asks for {current.words}"
        )


def layout_of(interface: Interface) -> ObservationLayout:
    """Return the observation layout of an exported policy."""
    fields = ObservationLayout.model_fields
    return ObservationLayout(**{name: getattr(interface, name) for name in fields})


class ExportedPolicy:
    """Acts greedily on the Q-values of an exported file, or by its rates."""

    def __init__(self, file: Path) -> None:
        """Read the file."""
        self._policy = OnnxPolicy(file)
        self.interface = self._policy.interface
        self.kind = self.interface.kind
        self.risk_sign: RiskSign | None = self.interface.risk
        """When the risk is a warning; None without one in the file."""

    @property
    def risk(self) -> float | None:
        """Risk at the last decision; None without one in the file."""
        return self._policy.risk

    def reset(self, simulator: Simulator | None = None) -> None:
        """Forget the observations of the previous episode."""
        self._policy.reset()

    def act(self, p: Perception) -> Action:
        """Return the index of the action with the largest Q-value, or rates."""
        return self._policy.act(p.observation, p.position)

    def q_values(self, p: Perception) -> list[float]:
        """Return the Q-values, (3^J,)."""
        values = self._policy.q_values(stacked(p.recent, self.interface.frames))
        return [float(value) for value in values]

    def act_on(self, recent: Sequence[NDArray[np.float32]]) -> Action:
        """Return the action for the newest observation; the file's session keeps those before."""
        return self._policy.act(recent[-1])


def exported_config(file: Path) -> EvalConfig:
    """Return the file's evaluation configuration: robot, layout and terrain, all as in training.

    A stand-in replaces a terrain whose plugin is missing.
    """
    interface = OnnxPolicy(file).interface
    settings = {
        "terrain": dict(interface.terrain_config),
        "robot": {**interface.robot, "flippers": interface.flippers},
        "sim": default_engine(interface.flippers),
        "perception": layout_of(interface).model_dump(),
    }
    files = {(plugin.kind, plugin.name): plugin.file for plugin in interface.plugins}
    try:
        return parse(EvalConfig, with_stand_ins(settings, files))
    except ConfigError as error:
        raise PolicyError(f"{file}: its metadata are not valid in this version: {error}") from error


def check_robot(interface: Interface, robot: Robot, file: Path) -> None:
    """Check that a simulated robot agrees with the values that an exported file applies itself.

    On the real robot, the file's own action table, target limit and decision period apply,
    whatever the simulator's settings. All other properties are the robot's own.
    """
    disagreements = list(_disagreements(interface, robot))
    if not disagreements:
        return
    file_robot = parse(Robot, interface.robot)
    changed = [
        name for name in _APPLIED if not _close(getattr(file_robot, name), getattr(robot, name))
    ]
    if not changed:
        raise ConfigError(
            f"{file} applies {', '.join(disagreements)}, unlike the robot in its own metadata; "
            f"flipperctl inspect checkpoint {shlex.quote(str(file))} --check shows where"
        )

    # The settings with which a new file would agree, as they are typed
    values = {name: json.dumps(getattr(robot, name)) for name in changed}
    overrides = " ".join(f"robot.{name}={value}" for name, value in values.items())
    advice = f"export a matching file: flipperctl export onnx RUN {overrides}"
    if changed == ["flipper_speed"]:
        speed = values["flipper_speed"]
        advice += f", or keep the file's period with randomise.robot.flipper_speed={speed}"
    raise ConfigError(
        f"{file} applies {', '.join(disagreements)}, also on the real robot; {advice}"
    )


def _disagreements(interface: Interface, robot: Robot) -> Iterator[str]:
    """Yield a description of each value that the file applies instead of the robot's."""
    rule = interface.targets
    step, limit, period = robot.angle_step, robot.angle_limit, robot.decision_period
    table = turns(step, interface.kind, len(interface.joints))
    if not np.allclose(interface.actions, table, rtol=0.0, atol=_CLOSE):
        largest = np.abs(interface.actions).max()
        yield f"turns of {largest:.6g} rad (robot.angle_step asks for {step:.6g})"
    elif math.isfinite(rule.window) and not _close(rule.window, step):
        yield f"targets within {rule.window:.6g} rad (robot.angle_step asks for {step:.6g})"
    if math.isfinite(rule.limit) and not _close(rule.limit, limit):
        yield f"a limit of {rule.limit:.6g} rad (robot.angle_limit asks for {limit:.6g})"
    if not _close(interface.decision_period, period):
        is_set = robot.control_period is not None
        cause = "robot.control_period" if is_set else "robot.angle_step / robot.flipper_speed"
        period_text = f"{interface.decision_period:.6g} s"
        yield f"a decision period of {period_text} ({cause} asks for {period:.6g})"


def _close(first: float | None, second: float | None) -> bool:
    if first is None or second is None:
        return first is second
    return abs(first - second) <= _CLOSE
