"""The metadata of an exported policy: strings under ``flipperctl.*`` in its file.

In: the configuration of a training, with the robot that the export is for. Out: all that a robot
needs to run the file, as ``flipperctl.runtime.interface`` reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from itertools import pairwise
from typing import Any

from flipperctl import __version__
from flipperctl.api import ObservationLayout
from flipperctl.checkpoint.document import PluginReference
from flipperctl.config import TrainConfig, to_dict
from flipperctl.core import observation
from flipperctl.core.lidar.ground import MEANING as MEANING_OF_MAP
from flipperctl.core.risk import ESCAPE_MEANING as MEANING_OF_ESCAPE
from flipperctl.core.risk import LAGS, SCALE, RiskSign
from flipperctl.core.risk import MEANING as MEANING_OF_RISK
from flipperctl.core.targets import JOINTS, MEANING, turns
from flipperctl.runtime.interface import FORMAT_VERSION, PREFIX

_CALLED = {
    joint: joint.replace("_", " ") + (" flippers" if flippers == "pairs" else " flipper")
    for flippers, joints in JOINTS.items()
    for joint in joints
}
"""Name of a joint → words for it."""


def policy_metadata(
    config: TrainConfig, plugins: Iterable[PluginReference] = (), risk: RiskSign | None = None
) -> dict[str, str]:
    """Return the metadata of a policy without its checksum; values other than text are JSON.

    ``config``: configuration of the training, with the robot that the export is for. ``plugins``:
    those of the training. ``risk``: when the policy's risk is a warning, if it has one.
    """
    layout, robot = config.perception, config.robot
    values: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "observation": describe_observation(layout),
        "bins": layout.bins,
        "bin_width": layout.bin_width,
        "highest": layout.highest,
        "frames": config.network.frames,
        "joints": robot.joints,
        "actions": turns(robot.angle_step, config.actions, len(robot.joints)).tolist(),
        "targets": {"meaning": MEANING, "window": robot.angle_step, "limit": robot.angle_limit},
        "decision_period": robot.decision_period,
        "robot": robot.model_dump(mode="json", exclude_none=True, exclude={"flippers"}),
        "terrain": config.terrain.plugin_name,
        "terrain_config": to_dict(config.terrain),
        "seed": config.seed,
        "network": config.network.plugin_name,
    }
    # What only some policies have: sides, plugins in files, a risk, an escape, a map.
    if layout.sides:
        values["sides"] = True
    if files := [p for p in plugins if p.file is not None]:
        values["plugins"] = [{"kind": p.kind, "name": p.name, "file": p.file} for p in files]
    if risk is not None:
        sign = {"meaning": MEANING_OF_RISK, **asdict(risk)}
        values["risk"] = {**sign, "lags": LAGS, "scale": SCALE}
        settings = config.agent.failure_risk
        if settings is not None and (escape := settings.escape) is not None:
            values["escape"] = {"meaning": MEANING_OF_ESCAPE, **asdict(escape)}
    if layout.lidar is not None:
        values["map"] = {"meaning": MEANING_OF_MAP, **asdict(layout.lidar.quality)}
    return {
        f"{PREFIX}{name}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


def describe_observation(layout: ObservationLayout) -> list[dict[str, str]]:
    """Return the name, unit, frame and meaning of each of an observation's numbers."""
    edges = list(pairwise(observation.edges(layout.bins, layout.bin_width)))
    *flippers, pitch = observation.angles(joints=len(layout.joints))
    sides = tuple(observation.SIDES) if layout.sides else ()
    kinds = {"h": "mean terrain height", **({"top": "highest point"} if layout.highest else {})}
    where = {"": "", **({s: f" below the {s[:-1]} tracks" for s in sides})}
    rows = [
        *(
            (
                f"{side}{name}_{i}",
                "m",
                "L",
                f"{what}{place}, up positive, for x in [{low:.3f}, {high:.3f}) m",
            )
            for side, place in where.items()
            for name, what in kinds.items()
            for i, (low, high) in enumerate(edges, 1)
        ),
        *([(observation.ROLL, "rad", "L", "roll, left side up positive")] if sides else []),
        *(
            (name, "rad", "R", f"{_CALLED[joint]}, above chassis positive")
            for name, joint in zip(flippers, layout.joints, strict=True)
        ),
        (pitch, "rad", "L", "pitch, nose up positive"),
    ]
    return [dict(zip(("name", "unit", "frame", "meaning"), row, strict=True)) for row in rows]
