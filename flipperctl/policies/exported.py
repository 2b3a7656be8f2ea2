"""An exported file judged in the simulator as the robot runs it.

In: a file of ``flipperctl export onnx``. Out: a controller, and the evaluation that it asks for.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl.api import Perception, Simulator
from flipperctl.config import EvalConfig, parse
from flipperctl.errors import ConfigError, PolicyError
from flipperctl.runtime import OnnxPolicy


class ExportedPolicy:
    """Greedy in the Q-values of an exported file."""

    def __init__(self, file: Path) -> None:
        self._policy = OnnxPolicy(file)
        self.interface = self._policy.interface

    def reset(self, simulator: Simulator) -> None:
        """Forget the observations of the episode before."""
        self._policy.reset()

    def act(self, p: Perception) -> int:
        """The action of the largest Q-value."""
        return self._policy.act(p.observation)


def is_exported(file: Path) -> bool:
    """Whether a file is meant as an exported policy, not as a checkpoint."""
    return file.suffix == ".onnx"


def exported_config(file: Path) -> EvalConfig:
    """The file's own evaluation: its robot, its layout and its terrain, all as in training.

    A file of format 1 says only the terrain's name, which then has its defaults.

    Raises:
        PolicyError: flipperctl did not export the file, or this version lacks what it names.
    """
    says = OnnxPolicy(file).interface
    settings = {
        "terrain": dict(says.terrain_config),
        "robot": dict(says.robot),
        "perception": {"bins": says.bins, "bin_width": says.bin_width},
    }
    try:
        return parse(EvalConfig, settings)
    except ConfigError as error:
        raise PolicyError(f"{file}: what its metadata say does not fit: {error}") from error
