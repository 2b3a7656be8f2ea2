"""An exported file as a policy in the simulator, run as the robot runs it.

In: a file of ``flipperctl export onnx``. Out: a policy, the evaluation configuration in its
metadata, and a check of a robot against the values that the file itself applies.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.api import Perception, Robot, Simulator
from flipperctl.config import EvalConfig, parse
from flipperctl.config.absent import with_stand_ins
from flipperctl.core.risk import RiskSign
from flipperctl.core.targets import turns
from flipperctl.errors import ConfigError, PolicyError
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import Interface

_CLOSE = 1e-6
"""Largest difference of angles, speeds and periods that counts as rounding [SI units]."""
_APPLIED = ("angle_step", "angle_limit", "flipper_speed", "control_period")
"""Settings of a robot that a file applies itself."""


class ExportedPolicy:
    """Acts greedily on the Q-values of an exported file."""

    def __init__(self, file: Path) -> None:
        """Read the file."""
        self._policy = OnnxPolicy(file)
        self.interface = self._policy.interface

    @property
    def risk(self) -> float | None:
        """Risk at the last decision; None without one in the file."""
        return self._policy.risk

    @property
    def risk_sign(self) -> RiskSign | None:
        """When the risk is a warning; None without one in the file."""
        return self.interface.risk

    def reset(self, simulator: Simulator | None = None) -> None:
        """Forget the observations of the previous episode."""
        self._policy.reset()

    def act(self, p: Perception) -> int:
        """Return the index of the action with the largest Q-value, 0 to 8."""
        return self._policy.act(p.observation)

    def q_values(self, p: Perception) -> list[float]:
        """Return the Q-values, (9,)."""
        values: list[float] = self._policy.q_values(
            stacked(p.recent, self.interface.frames)
        ).tolist()
        return values

    def act_on(self, recent: Sequence[NDArray[np.float32]]) -> int:
        """Return the action for the newest observation; the file's session keeps those before."""
        return self._policy.act(recent[-1])


def exported_config(file: Path) -> EvalConfig:
    """Return the file's evaluation configuration: robot, layout and terrain, all as in training.

    A stand-in replaces a terrain whose plugin is missing (see ``config.absent``).
    """
    interface = OnnxPolicy(file).interface
    settings = {
        "terrain": dict(interface.terrain_config),
        "robot": dict(interface.robot),
        "perception": {"bins": interface.bins, "bin_width": interface.bin_width},
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
    found = list(_disagreements(interface, robot))
    if not found:
        return
    own = parse(Robot, interface.robot)
    changed = [name for name in _APPLIED if not _close(getattr(own, name), getattr(robot, name))]
    if not changed:
        raise ConfigError(
            f"{file} applies {', '.join(found)}, unlike the robot in its own metadata; "
            f"flipperctl inspect checkpoint {shlex.quote(str(file))} --check shows where"
        )
    values = {name: json.dumps(getattr(robot, name)) for name in changed}
    asked = " ".join(f"robot.{name}={value}" for name, value in values.items())
    advice = f"export a matching file: flipperctl export onnx --checkpoint RUN {asked}"
    if changed == ["flipper_speed"]:
        speed = values["flipper_speed"]
        advice += f", or keep the file's period with randomise.flipper_speed={speed}"
    raise ConfigError(f"{file} applies {', '.join(found)}, also on the real robot; {advice}")


def _disagreements(interface: Interface, robot: Robot) -> Iterator[str]:
    """Yield a description of each value that the file applies instead of the robot's."""
    rule = interface.targets
    step, limit, period = robot.angle_step, robot.angle_limit, robot.decision_period
    if not np.allclose(interface.actions, turns(step), rtol=0.0, atol=_CLOSE):
        largest = np.abs(interface.actions).max()
        yield f"turns of {largest:.6g} rad (robot.angle_step asks for {step:.6g})"
    elif math.isfinite(rule.window) and not _close(rule.window, step):
        yield f"targets within {rule.window:.6g} rad (robot.angle_step asks for {step:.6g})"
    if math.isfinite(rule.limit) and not _close(rule.limit, limit):
        yield f"a limit of {rule.limit:.6g} rad (robot.angle_limit asks for {limit:.6g})"
    if not _close(interface.decision_period, period):
        given = robot.control_period is not None
        cause = "robot.control_period" if given else "robot.angle_step / robot.flipper_speed"
        found = f"{interface.decision_period:.6g} s"
        yield f"a decision period of {found} ({cause} asks for {period:.6g})"


def _close(ours: float | None, theirs: float | None) -> bool:
    if ours is None or theirs is None:
        return ours is theirs
    return abs(ours - theirs) <= _CLOSE
