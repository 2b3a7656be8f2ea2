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

from flipperctl.api import FloatArray, RobotState, RollingWorld
from flipperctl.config import EvalConfig
from flipperctl.core.observation import SIDES
from flipperctl.core.targets import angles_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.runtime.policy import OnnxPolicy
from flipperctl.sim.planar.sensing import ground_beside
from flipperctl.text.files import OutputKind, check_output, write_bytes

FILE = OutputKind("vectors", (".json",), re.compile(rb'\A\{"policy": '))
COUNT = 200
"""Number of instants."""
_EVERY = 4  # of the points beside the robot one in so many is written


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
        **({"sides": True} if interface.sides else {}),
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


def _beside(
    env: FlipperEnv, state: RobotState, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the ground below the left and the right tracks, (P, 2) [m] each; 2-D: ``points``."""
    world: Any = env.drive.world
    if not isinstance(world.of_engine, RollingWorld):
        return points, points
    ground = ground_beside(world, state, env.config.perception.reach)
    left, right = (ground[ground[:, 1] * sign > 0] for sign in SIDES.values())
    return left[::_EVERY, [0, 2]], right[::_EVERY, [0, 2]]


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
        sides = points, points
        if policy.interface.sides:
            sides = _beside(env, decision.transition.before, points)
        left, right = sides
        # A robot that fell off its ground sees nothing, and decides nothing.
        if not (len(points) and len(left) and len(right)):
            continue
        targets = measured if targets is None else targets
        # The port's way: from points and angles to the observation, the input and the answer
        front, rear = measured[:half], measured[half:]
        observation = policy.observation(
            points, front=front, rear=rear, pitch=seen.pitch, sides=sides, roll=seen.roll
        )
        beside = {"left": left.tolist(), "right": right.tolist(), "roll": seen.roll}
        missing = policy.interface.frames - len(frames) - 1
        frames = [*frames, observation][-policy.interface.frames :]
        stacked = np.concatenate([frames[0]] * max(0, missing) + frames)
        action = policy.act(observation)
        after = policy.next_targets(targets, measured, action).tolist()
        rows.append(
            {
                "episode": episode,
                "points": points.tolist(),
                **(beside if policy.interface.sides else {}),
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
