"""The metadata of an exported policy.

In: a training configuration. Out: all that a robot needs to run the policy, as strings under
``flipperctl.*``.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import pairwise
from typing import Any

from flipperctl import __version__
from flipperctl.api import ObservationLayout
from flipperctl.checkpoint import plugin_references
from flipperctl.config import TrainConfig, resolver
from flipperctl.core import observation
from flipperctl.core.escape import MEANING as MEANING_OF_ESCAPE
from flipperctl.core.lidar.map_quality import MEANING as MEANING_OF_MAP
from flipperctl.core.risk import LAGS, SCALE, RiskSign
from flipperctl.core.risk import MEANING as MEANING_OF_RISK
from flipperctl.core.targets import MEANING
from flipperctl.runtime.checksum import FORMAT_VERSION, PREFIX
from flipperctl.sim.lidar.sensor import LidarSensor


def policy_metadata(config: TrainConfig, risk: RiskSign | None = None) -> dict[str, str]:
    """Return the metadata of a policy without its checksum; values other than text are JSON.

    ``config``: configuration of the training, with the robot that the export is for. ``risk``: when
    the policy's risk is a warning, if it has one.
    """
    layout, robot = config.perception, config.robot
    values: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "observation": describe_observation(layout),
        "bins": layout.bins,
        "bin_width": layout.bin_width,
        "frames": config.network.frames,
        "joints": robot.actions.joints,
        "actions": robot.actions.turns(robot.angle_step).tolist(),
        "targets": {"meaning": MEANING, "window": robot.angle_step, "limit": robot.angle_limit},
        "decision_period": robot.decision_period,
        "robot": robot.model_dump(mode="json", exclude_none=True),
        "terrain": config.terrain.plugin_name,
        "terrain_config": resolver.to_dict(config.terrain),
        "seed": config.seed,
        "network": config.network.plugin_name,
    }
    if files := [p for p in plugin_references(config) if p.file is not None]:
        values["plugins"] = [{"kind": p.kind, "name": p.name, "file": p.file} for p in files]
    if risk is not None:
        values["risk"] = {
            "meaning": MEANING_OF_RISK,
            "horizon": risk.horizon,
            "threshold": risk.threshold,
            "lags": LAGS,
            "scale": SCALE,
        }
        if (escape := config.agent.escape) is not None:
            values["escape"] = {"meaning": MEANING_OF_ESCAPE, **asdict(escape)}
    if isinstance(layout, LidarSensor):
        values["map"] = {"meaning": MEANING_OF_MAP, **asdict(layout.map_quality)}
    return {
        f"{PREFIX}{name}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


def describe_observation(layout: ObservationLayout) -> list[dict[str, str]]:
    """Return the name, unit, frame and meaning of each of an observation's N + 3 numbers."""
    edges = pairwise(observation.edges(layout.bins, layout.bin_width))
    heights = [
        {
            "name": f"h_{i + 1}",
            "unit": "m",
            "frame": "L",
            "meaning": f"mean terrain height, up positive, for x in [{low:.3f}, {high:.3f}) m",
        }
        for i, (low, high) in enumerate(edges)
    ]
    angles = (
        ("R", "front flippers, above chassis positive"),
        ("R", "rear flippers, above chassis positive"),
        ("L", "pitch, nose up positive"),
    )
    return heights + [
        {"name": name, "unit": "rad", "frame": frame, "meaning": meaning}
        for name, (frame, meaning) in zip(observation.ANGLES, angles, strict=True)
    ]
