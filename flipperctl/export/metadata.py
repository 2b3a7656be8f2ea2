"""The metadata of an exported policy.

In: a training configuration. Out: what a robot must know to run the policy, as strings under
``flipperctl.*``.
"""

from __future__ import annotations

import json
from typing import Any

from flipperctl import __version__
from flipperctl.api import ACTIONS, ObservationLayout
from flipperctl.checkpoint import plugin_references
from flipperctl.config import TrainConfig, resolver
from flipperctl.core.targets import MEANING
from flipperctl.runtime.checksum import FORMAT_VERSION, PREFIX


def policy_metadata(config: TrainConfig) -> dict[str, str]:
    """Return the metadata of a policy, without its checksum; values that are not text are JSON.

    ``config``: that of its training, with the robot that the policy is exported for.
    """
    layout, robot = config.perception, config.robot
    table = [[front * robot.angle_step, rear * robot.angle_step] for front, rear in ACTIONS]
    geometry = robot.model_dump(mode="json")
    values: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "observation": describe_observation(layout),
        "bins": layout.bins,
        "bin_width": layout.bin_width,
        "frames": config.network.frames,
        "actions": table,
        "targets": {"meaning": MEANING, "window": robot.angle_step, "limit": robot.angle_limit},
        "decision_period": robot.decision_period,
        "robot": geometry,
        "terrain": config.terrain.plugin_name,
        "terrain_config": resolver.container(config.terrain),
        "seed": config.seed,
        "network": config.network.plugin_name,
    }
    if files := [p for p in plugin_references(config) if p.file is not None]:
        values["plugins"] = [{"kind": p.kind, "name": p.name, "file": p.file} for p in files]
    return {
        f"{PREFIX}{name}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


def describe_observation(layout: ObservationLayout) -> list[dict[str, str]]:
    """Return name, unit, frame and meaning of each of the N + 3 numbers of an observation."""
    low, width = -layout.reach, layout.bin_width
    heights = [
        {
            "name": f"h_{i + 1}",
            "unit": "m",
            "frame": "L",
            "meaning": "mean terrain height, up positive, for x in "
            f"[{low + i * width:.3f}, {low + (i + 1) * width:.3f}) m",
        }
        for i in range(layout.bins)
    ]
    flipper = {"unit": "rad", "frame": "R"}
    return [
        *heights,
        {"name": "theta_f1", **flipper, "meaning": "front flippers, above chassis positive"},
        {"name": "theta_f2", **flipper, "meaning": "rear flippers, above chassis positive"},
        {"name": "theta_R", "unit": "rad", "frame": "L", "meaning": "pitch, nose up positive"},
    ]
