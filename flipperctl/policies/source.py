"""Where a policy comes from, in a few words that another process can be given.

In: a file, or the name and settings of a controller plugin. Out: a policy, trained, exported or
ruled alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl.api import Controller, Policy, Robot
from flipperctl.checkpoint import find, read, shipped_policies
from flipperctl.config import EnvConfig, resolver
from flipperctl.errors import CheckpointError
from flipperctl.lookahead import Planner
from flipperctl.policies.exported import (
    ExportedPolicy,
    check_robot,
    exported_config,
    is_exported,
)
from flipperctl.policies.plugin import PluginPolicy
from flipperctl.policies.trained import TrainedPolicy, policy_module


@dataclass(frozen=True)
class PolicySource:
    """Where a policy comes from: a file or a controller plugin; one of the two is given."""

    checkpoint: Path | None = None
    """A checkpoint, or a file of ``flipperctl export onnx``."""
    settings: dict[str, Any] | None = None
    """``name`` and fields of a controller plugin."""

    @classmethod
    def of_plugin(cls, name: str, path: str) -> PolicySource:
        """Return the source of a registered controller at its defaults.

        ``path``: the option or configuration key that asks for it, for the error.

        Raises:
            ConfigError: there is no such controller, or its defaults are not valid.
        """
        return cls(settings=resolver.container(resolver.create("controller", name, path)))

    def label(self) -> str:
        """Return the name that tables and files use.

        It is the name of a shipped policy or of a controller plugin, else the file's path.
        """
        if self.checkpoint is not None:
            shipped = {file: name for name, file in shipped_policies().items()}
            return shipped.get(self.checkpoint, str(self.checkpoint))
        return str((self.settings or {})["name"])

    def baselines(self) -> tuple[str, ...]:
        """Return the controllers that stand beside this one's results, unless others are named."""
        if self.checkpoint is not None:
            return ()
        found = resolver.create("controller", self.settings, "controller")
        assert isinstance(found, Controller)
        return found.baselines

    def robot(self) -> Robot | None:
        """Return the robot that a file's policy is for; None of a controller plugin.

        Raises:
            CheckpointError: the file is missing or damaged.
            PolicyError: the exported file is damaged.
        """
        if self.checkpoint is None:
            return None
        if is_exported(self.checkpoint):
            return exported_config(self.checkpoint).robot
        return read(self.checkpoint).policy_config().robot

    def build(self, config: EnvConfig) -> Policy:
        """Build the policy for an environment of this configuration.

        Raises:
            CheckpointError: the policy was trained on another observation layout, or its file is
                missing or damaged.
            ConfigError: the environment's robot contradicts what an exported file applies itself.
            PolicyError: the exported file is damaged.
            PluginFailedError: the controller's code failed.
        """
        if self.checkpoint is None:
            controller = resolver.create("controller", self.settings, "controller")
            if isinstance(controller, Planner) and controller.policy:
                file = find(Path(controller.policy))
                controller = controller.starting_from(PolicySource(file).build(config))
            return PluginPolicy(controller)
        bins, bin_width, policy = _open(self.checkpoint)
        layout = config.perception
        if (bins, bin_width) != (layout.bins, layout.bin_width):
            raise CheckpointError(
                f"{self.checkpoint}: the policy was trained on {bins} bins of {bin_width:g} m; "
                "perception.bins and perception.bin_width ask for "
                f"{layout.bins} of {layout.bin_width:g} m"
            )
        if isinstance(policy, ExportedPolicy):
            check_robot(policy.interface, config.robot, self.checkpoint)
        return policy


def _open(file: Path) -> tuple[int, float, Policy]:
    """Return the number of bins that a file's policy takes, their width [m] and the policy."""
    if is_exported(file):
        exported = ExportedPolicy(file)
        return exported.interface.bins, exported.interface.bin_width, exported
    checkpoint = read(file)
    config = checkpoint.policy_config()
    policy = TrainedPolicy(policy_module(checkpoint), config.network.frames)
    return config.perception.bins, config.perception.bin_width, policy
