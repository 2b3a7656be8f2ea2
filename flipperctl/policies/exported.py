"""An exported policy in the simulator, run as the robot runs it.

In: a file of ``flipperctl export onnx``. Out: a policy, and the settings of its own evaluation.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl.api import Perception, Simulator
from flipperctl.config import EvalConfig, parse
from flipperctl.errors import ConfigError, PolicyError
from flipperctl.runtime import OnnxPolicy


class ExportedPolicy:
    """Takes the greedy action of an exported file."""

    def __init__(self, file: Path) -> None:
        self._policy = OnnxPolicy(file)
        self.interface = self._policy.interface

    def reset(self, simulator: Simulator) -> None:
        """Forget the observations of the previous episode."""
        self._policy.reset()

    def act(self, p: Perception) -> int:
        """Return the action of the largest Q-value."""
        return self._policy.act(p.observation)


def is_exported(file: Path) -> bool:
    """Return whether the name is that of an exported policy, not of a checkpoint."""
    return file.suffix == ".onnx"


def exported_config(file: Path) -> EvalConfig:
    """Return the evaluation with the robot, observation layout and terrain of the training.

    A file of format 1 holds only the name of the terrain, which then has its default settings.

    Raises:
        PolicyError: flipperctl did not export the file, or this version lacks its terrain plugin
            or one of its settings.
    """
    interface = OnnxPolicy(file).interface
    settings = {
        "terrain": dict(interface.terrain_config),
        "robot": dict(interface.robot),
        "perception": {"bins": interface.bins, "bin_width": interface.bin_width},
    }
    try:
        return parse(EvalConfig, settings)
    except ConfigError as error:
        raise PolicyError(f"{file}: its metadata do not fit this version: {error}") from error
