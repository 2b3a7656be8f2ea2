"""A picklable reference to a policy.

In: a file, or the name and settings of a controller plugin. Out: the policy. Torch is imported only
for a file of torch's: rules need none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl.api import Controller, Policy, Robot
from flipperctl.checkpoint import find, read_policy, shipped_policies
from flipperctl.config import EnvConfig, resolver
from flipperctl.errors import CheckpointError
from flipperctl.lookahead import Mpc, ValueIteration
from flipperctl.policies.abilities import PolicyUser
from flipperctl.policies.exported import (
    ExportedPolicy,
    check_robot,
    exported_config,
    is_exported,
)
from flipperctl.policies.plugin import PluginPolicy, plugin_policy


@dataclass(frozen=True)
class PolicySource:
    """Where a policy comes from: either a file or a controller plugin."""

    checkpoint: Path | None = None
    """A checkpoint, or a file of ``flipperctl export onnx``."""
    settings: dict[str, Any] | None = None
    """``name`` and fields of a controller plugin."""

    @classmethod
    def of_plugin(cls, name: str, path: str) -> PolicySource:
        """Return the source of a registered controller at its ``reference_settings``.

        ``path``: the option or configuration key that asks for it, for the error.

        Raises:
            ConfigError: there is no such controller, or its defaults are not valid.
        """
        found = resolver.create("controller", resolver.reference(name, path), path)
        return cls(settings=resolver.to_dict(found))

    def label(self) -> str:
        """Return the name that tables and files use.

        It is the name of a shipped policy or of a controller plugin, otherwise the file's path.
        """
        if self.checkpoint is not None:
            shipped = {file: name for name, file in shipped_policies().items()}
            return shipped.get(self.checkpoint, str(self.checkpoint))
        return str((self.settings or {})["name"])

    @property
    def controller_name(self) -> str | None:
        """Name of the controller plugin; None for a file."""
        return None if self.settings is None else str(self.settings["name"])

    def baselines(self) -> tuple[str, ...]:
        """Return the controllers that this policy is compared with by default."""
        if self.checkpoint is not None:
            return ()
        return self.controller().baselines

    def robot(self) -> Robot | None:
        """Return the robot that a file's policy was made for; None for a controller plugin.

        Raises:
            CheckpointError: the file is missing or damaged.
            PolicyError: the exported file is damaged.
        """
        if self.checkpoint is None:
            return None
        if is_exported(self.checkpoint):
            return exported_config(self.checkpoint).robot
        return read_policy(self.checkpoint).policy_config().robot

    def build(self, config: EnvConfig) -> Policy:
        """Build the policy for an environment of this configuration.

        Raises:
            CheckpointError: the policy was trained on another observation layout, or its file is
                missing or damaged.
            ConfigError: the environment's robot contradicts values that an exported file applies.
            PolicyError: the exported file is damaged.
            PluginFailedError: the controller's code failed.
        """
        if self.checkpoint is None:
            return controller_policy(self.controller(), config)
        if is_exported(self.checkpoint):
            return _exported(self.checkpoint, config)
        return _trained(self.checkpoint, config)

    @property
    def plans_for_rewards(self) -> bool:
        """Whether the policy is a controller that drives for the configured rewards."""
        return self.checkpoint is None and isinstance(self.controller(), ValueIteration)

    def notes(self, config: EnvConfig) -> Iterator[str]:
        """Yield what a controller does otherwise than its settings name in this environment.

        Raises:
            CheckpointError: a file is missing or damaged.
        """
        if self.checkpoint is None:
            yield from controller_notes(self.controller(), config)

    def controller(self) -> Controller:
        """Return the controller plugin, for a source without a file.

        Raises:
            ConfigError: there is no such controller, or its settings are not possible.
        """
        found = resolver.create("controller", self.settings, "controller")
        assert isinstance(found, Controller)
        return found


def controller_policy(
    controller: Controller, config: EnvConfig, path: str = "controller"
) -> PluginPolicy:
    """Return the policy of a controller with the files and rewards that it uses.

    ``path``: section of the controller, for errors.

    Raises:
        CheckpointError: a file is missing or damaged, or does not fit the environment.
        ConfigError: the controller's settings are not possible.
        PluginFailedError: the controller's code failed.
    """
    return plugin_policy(with_files(controller, config, path))


def with_files(controller: Controller, config: EnvConfig, path: str = "controller") -> Controller:
    """Return a controller with the files and rewards that it uses, ready to be built.

    ``path``: section of the controller, for errors.

    Raises:
        CheckpointError: a file is missing or damaged, or does not fit the environment.
    """
    if isinstance(controller, PolicyUser) and controller.named:
        policies = [_named(f"{path}.{key}", name, config) for key, name in controller.named.items()]
        controller = controller.starting_from(policies)
    if isinstance(controller, Mpc) and controller.value:
        from flipperctl.policies.values import learned_value

        learned = learned_value(controller.value, f"{path}.value")
        if controller.fallback and any(learned.misfits(config.robot, config.perception.layout)):
            controller = controller.without_value()
        else:
            controller = controller.ending_with(learned)
    if isinstance(controller, ValueIteration):
        controller = controller.paying(config.rewards)
    return controller


def controller_notes(
    controller: Controller, config: EnvConfig, path: str = "controller"
) -> Iterator[str]:
    """Yield a line if ``with_files`` replaces the values of a controller by its own cost.

    Raises:
        CheckpointError: the file is missing or damaged.
    """
    if isinstance(controller, Mpc) and controller.value and controller.fallback:
        from flipperctl.policies.values import learned_value

        learned = learned_value(controller.value, f"{path}.value")
        found = list(learned.misfits(config.robot, config.perception.layout))
        if found:
            yield (
                f"{path}.value: {controller.value} was not trained for {', '.join(found)}; plans "
                f"have the hand-set cost instead; {path}.value={controller.value} keeps the values"
            )


def _named(path: str, name: str, config: EnvConfig) -> Policy:
    """Return the policy that a setting at ``path`` names."""
    from flipperctl.policies.values import naming

    with naming(path):
        file = find(Path(name))
    return PolicySource(file).build(config)


def _exported(file: Path, config: EnvConfig) -> Policy:
    """Return the policy of an exported file for an environment with a matching robot."""
    policy = ExportedPolicy(file)
    interface = policy.interface
    check_layout(file, interface.bins, interface.bin_width, config)
    check_robot(interface, config.robot, file)
    return policy


def _trained(file: Path, config: EnvConfig) -> Policy:
    """Return the policy of a checkpoint for an environment."""
    from flipperctl.policies.trained import TrainedPolicy, policy_module, policy_risk

    checkpoint = read_policy(file)
    trained = checkpoint.policy_config()
    module, risk = policy_module(checkpoint), policy_risk(checkpoint)
    policy = TrainedPolicy(module, trained.network.frames, risk, trained.agent.escape)
    check_layout(file, trained.perception.bins, trained.perception.bin_width, config)
    return policy


def check_layout(file: Path, bins: int, bin_width: float, config: EnvConfig) -> None:
    """Check that an environment has the observation layout of a policy; ``bin_width`` [m].

    Raises:
        CheckpointError: it has another one; the text names ``file``.
    """
    layout = config.perception
    if (bins, bin_width) != (layout.bins, layout.bin_width):
        raise CheckpointError(
            f"{file}: the policy was trained on {bins} bins of {bin_width:g} m; "
            "perception.bins and perception.bin_width ask for "
            f"{layout.bins} of {layout.bin_width:g} m"
        )
