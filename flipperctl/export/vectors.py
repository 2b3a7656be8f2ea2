"""Recorded instants of an exported policy, with which a port to another language can be tested.

In: an exported file, and a scene. Out: for each instant what was measured, and everything that
follows from it: observation, input of the network, Q-values or rates, action and targets.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.config import EvalConfig
from flipperctl.core.targets import angles_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.runtime.policy import OnnxPolicy
from flipperctl.text.files import OutputKind, check_output, write_bytes

FILE = OutputKind("vectors", (".json",), re.compile(rb'\A\{"policy": '))
COUNT = 200
"""Number of instants."""


def export_vectors(
    config: EvalConfig, source: PolicySource, output: Path, count: int = COUNT
) -> dict[str, Any]:
    """Write the first decisions of a policy's episodes as JSON; return what the file has.

    Raises:
        RequestError: the policy is no exported file.
    """
    check_output(output, FILE)
    file = source.file
    if file is None or file.suffix != ".onnx":
        raise RequestError(
            f"{source.label()} is no exported policy; write one by flipperctl export onnx, and "
            "name the file"
        )
    policy, env = OnnxPolicy(file, escape=False), FlipperEnv(config=config)
    if policy.interface.sides:
        raise RequestError(f"{file}: vectors have the side plane alone; the policy has both sides")
    seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
    instants: list[dict[str, Any]] = []
    episode = 0
    while len(instants) < count:
        instants += _episode(policy, env, source.build(config), seeds(episode), episode)
        episode += 1
    interface = policy.interface
    document = {
        "policy": file.name,
        "bins": interface.bins,
        "bin_width": interface.bin_width,
        "highest": interface.highest,
        "frames": interface.frames,
        "kind": interface.kind,
        "actions": interface.actions.tolist(),
        "window": interface.targets.window,
        "limit": interface.targets.limit,
        "instants": instants[:count],
    }
    write_bytes(output, (json.dumps(document) + "\n").encode())
    return {
        "format": "vectors",
        "output": str(output),
        "instants": count,
        "episodes": episode,
        "terrain": config.terrain.plugin_name,
    }


def _episode(
    policy: OnnxPolicy, env: FlipperEnv, driver: Any, seed: int, episode: int
) -> list[dict[str, Any]]:
    """Return the instants of one episode, which ``driver`` drives."""
    rows: list[dict[str, Any]] = []
    frames: list[Any] = []
    targets: list[float] | None = None
    policy.reset()
    for decision in decisions(env, driver, seed):
        seen = decision.perception
        points = seen.points if seen.filled is None else seen.points[~seen.filled]
        measured = list(angles_of(seen))
        half = len(measured) // 2
        targets = measured if targets is None else targets
        # The port's way: from points and angles to the observation, the input and the answer
        observation = policy.observation(
            points, front=measured[:half], rear=measured[half:], pitch=seen.pitch
        )
        missing = policy.interface.frames - len(frames) - 1
        frames = [*frames, observation][-policy.interface.frames :]
        stacked = np.concatenate([frames[0]] * max(0, missing) + frames)
        action = policy.act(observation)
        after = policy.next_targets(targets, measured, action).tolist()
        rows.append(
            {
                "episode": episode,
                "points": points.tolist(),
                "front": seen.front,
                "rear": seen.rear,
                **({"flippers": measured} if seen.flippers else {}),
                "pitch": seen.pitch,
                "observation": observation.tolist(),
                "input": stacked.tolist(),
                policy.interface.output: policy.q_values(stacked).tolist(),
                "action": action,
                "targets_before": targets,
                "targets": after,
            }
        )
        targets = after
    return rows
