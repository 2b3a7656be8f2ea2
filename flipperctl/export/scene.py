"""Export of a robot and the ground of an episode for other simulators: MJCF or URDF.

In: the configuration of an evaluation in 3-D. Out: one MJCF file of both, or two URDF files.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.rollout.episode import EvaluationSeeds
from flipperctl.text.files import OutputKind, check_output, write_bytes

_URDF = re.compile(rb'<robot name="(flipperctl"|ground">\s*<link name="ground">)')
SceneFormat = Literal["mjcf", "urdf"]
_KINDS: dict[SceneFormat, OutputKind] = {
    "mjcf": OutputKind("an MJCF scene", (".xml",), re.compile(rb'<mujoco model="flipperctl')),
    "urdf": OutputKind("a URDF", (".urdf",), _URDF),
}


def export_scene(config: EvalConfig, format: SceneFormat, output: Path) -> dict[str, Any]:
    """Write the scene of the first episode of an evaluation; return what was written.

    MJCF is one file with robot and ground. URDF is one of the robot, and one of the ground beside
    it (``ground_file``).

    Raises:
        ConfigError: the engine is not ``mujoco``, whose model is written.
        MissingExtraError: MuJoCo is not installed.
        OutputError: a file cannot be written, see ``check_output``.
    """
    for path in [output] if format == "mjcf" else [output, ground_file(output)]:
        check_output(path, _KINDS[format])
    # The first episode of the evaluation, as the engine places it.
    env = FlipperEnv(config=config)
    env.reset(seed=EvaluationSeeds.of(config.eval.seed, config.terrain)(0))
    # After the reset, which explains a missing or unusable MuJoCo.
    from flipperctl.sim.mujoco import description
    from flipperctl.sim.mujoco.world import MujocoWorld

    world = env.drive.world.of_engine
    if not isinstance(world, MujocoWorld):
        raise ConfigError(
            f"sim: {config.sim.plugin_name} has no model in 3-D to write; sim=mujoco is allowed"
        )
    texts = {output: description.mjcf(world)}
    if format == "urdf":
        texts = {
            output: description.urdf(world),
            ground_file(output): description.ground_urdf(world.ground),
        }
    for path, text in texts.items():
        write_bytes(path, text.encode())
    return {
        "format": format,
        "output": [str(path) for path in texts],
        "terrain": env.profile.label,
        "seed": config.eval.seed,
        "start": world.data.qpos[:3].tolist(),
        "boxes": len(world.ground),
    }


def ground_file(output: Path) -> Path:
    """Return the file of the ground beside that of the robot."""
    return output.with_name(f"{output.stem}_ground{output.suffix}")
