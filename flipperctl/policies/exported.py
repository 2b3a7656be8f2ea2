"""An exported file as a policy in the simulator, run as the robot runs it.

In: a file of ``flipperctl export onnx``. Out: a policy, and the evaluation that its metadata
describe.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl.api import Perception, Simulator
from flipperctl.config import EvalConfig, parse
from flipperctl.errors import ConfigError, PolicyError
from flipperctl.runtime import OnnxPolicy


class ExportedPolicy:
    """Acts greedily in the Q-values of an exported file."""

    def __init__(self, file: Path) -> None:
        """Read the file.

        Raises:
            PolicyError: the file is missing, damaged or not one of flipperctl.
        """
        self._policy = OnnxPolicy(file)
        self.interface = self._policy.interface

    def reset(self, simulator: Simulator) -> None:
        """Forget the observations of the previous episode."""
        self._policy.reset()

    def act(self, p: Perception) -> int:
        """Return the index of the action of the largest Q-value, 0 to 8."""
        return self._policy.act(p.observation)


def is_exported(file: Path) -> bool:
    """Return whether a file is meant as an exported policy, not as a checkpoint."""
    return file.suffix == ".onnx"


def exported_config(file: Path) -> EvalConfig:
    """Return the file's own evaluation: its robot, layout and terrain, all as in training.

    A file of format 1 holds only the terrain's name, which then has its defaults.

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
