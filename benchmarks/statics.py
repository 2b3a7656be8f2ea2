"""A lower bound of the pitch variation on a ground, from statics.

    python -m benchmarks.statics [--episodes N] [--seed N] [OVERRIDE …]

In: the ground's outline and the robot. Out: the smallest sum of absolute pitch changes with which
the chassis can pass through poses in which the robot can stand, whatever the flippers do: they may
take any angle at any time. The command prints its mean and range over the episodes of ``flipperctl
eval`` with the same words, a third of a second each.

A robot can stand if no part of it is inside the ground, and it touches the ground both ahead of and
behind its centre of mass. Every tolerance widens the set of poses, so that the sum is a lower bound
for a robot that stands at each place. A robot in motion may leave these poses for a moment, so it
bounds slow driving, not every motion.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Robot
from flipperctl.api.jit import cached
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.plugging import plugins
from flipperctl.process import entry
from flipperctl.rollout.episode import EvaluationSeeds
from flipperctl.sim.ground import inflated

_SPACING = 0.005
"""Distance of the places at which the ground is known [m]."""
_STRIDE = 4
"""Number of these distances between two places of the chassis centre [-]."""
_BLOCK = 500
"""Number of places of the chassis centre that are computed together, for memory [-]."""
_TOLERANCE = 0.01
"""Change of the tracks' radius that covers the rounding of places and angles [m]."""
_ANGLE = math.radians(1.0)
"""Distance of two pitches, and of two angles of a flipper [rad]."""
_TIPPING = 0.05
"""Distance to a standing pose within which the robot need not stand, as when it tips over an edge;
it may thus tip for twice that distance [m]."""


def static_bound(
    points: FloatArray,
    robot: Robot,
    *,
    start: float,
    finish: float,
    pitch: float = 0.0,
    clearance: float = 0.1,
    overturn: float = math.pi / 3,
) -> float:
    """Return the static lower bound of the sum of absolute pitch changes [rad].

    ``points`` is (V, 2) [m], with level ground before the first and past the last. The chassis
    centre moves from world x ``start`` to ``finish`` [m] and begins with ``pitch`` [rad]. At the
    finish, the chassis' higher end is at most ``clearance`` [m] above its place on level ground;
    the absolute pitch stays below ``overturn`` [rad]. A place at which the robot cannot stand at
    all adds nothing.
    """
    steep = int(overturn / _ANGLE)
    pitches = np.array([k * _ANGLE for k in range(-steep, steep + 1)])  # (P,) [rad]
    allowed = _widened(_standing(points, robot, start, finish, steep))
    last = math.asin(min(1.0, clearance / (2 * robot.hinge_offset))) + _ANGLE
    allowed[-1] &= np.abs(pitches) <= last
    cost = np.abs(pitches - pitch)  # (P,) [rad], of being at each pitch
    for here in allowed:
        if here.any():
            cost = _cheapest(np.where(here, cost, math.inf))
    return max(0.0, float(cost.min()) - _ANGLE / 2)  # the first pitch lies between two of the grid


def _standing(
    points: FloatArray, robot: Robot, start: float, finish: float, steep: int
) -> NDArray[np.bool_]:
    """Return whether the robot can stand at a place with a pitch, (X, 2·steep + 1).

    Places are from ``start`` to ``finish``, world x of the chassis centre [m], and pitches up to
    ``steep`` steps of ``_ANGLE``, nose up positive.
    """
    half, axle, radius = robot.hinge_offset, robot.flipper_axle, robot.track_radius
    margin = math.ceil((half + axle) / _SPACING) + 2  # to the farthest end of a flipper
    reach = margin * _SPACING + radius + _TOLERANCE
    first, last = min(start - reach, points[0, 0]), max(finish + reach, points[-1, 0])
    line = np.vstack([[first, points[0, 1]], points, [last, points[-1, 1]]])
    count = math.ceil((finish - start) / (_SPACING * _STRIDE)) + 1
    # The flippers' angles shift the centre of mass by at most this, for both pairs together, and a
    # load by its distance from the chassis centre.
    load = robot.carried_mass * math.hypot(*robot.centre_of_mass)
    shift = (robot.flipper_mass * axle + load) / robot.mass + _TOLERANCE
    turns = math.ceil(robot.angle_limit / _ANGLE) + 1
    sizes = np.array([_SPACING, half, axle, radius, shift, _ANGLE])
    blocks = []
    for first in range(0, count, _BLOCK):
        size = min(_BLOCK, count - first)
        origin = start + (first * _STRIDE - margin) * _SPACING
        known = (size - 1) * _STRIDE + 2 * margin + 1
        inner, outer = (
            inflated(line, origin, _SPACING, known, radius + sign * _TOLERANCE) for sign in (-1, 1)
        )
        blocks.append(_can_stand(inner, outer, size, _STRIDE, margin, steep, turns, sizes))
    return np.concatenate(blocks)


@cached(njit)
def _flipper(
    heights: FloatArray, forward: int, steep: int, turns: int, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest hinge at which a flipper touches, each (J, P) [m].

    Axes: place of the hinge, pitch of the chassis. ``forward`` is 1 for the front flippers and -1
    for the rear ones; ``heights`` are those of ``inflated``.
    """
    spacing, axle, step = sizes[0], sizes[2], sizes[5]
    samples = math.ceil(axle / spacing)
    angles = 2 * (steep + turns) + 1
    least = np.full((len(heights), 2 * steep + 1), np.inf)
    most = np.full((len(heights), 2 * steep + 1), -np.inf)
    needed = np.empty(angles)
    steps, rises = np.empty((angles, samples + 1), np.int64), np.empty((angles, samples + 1))
    for k in range(angles):
        angle = (k - steep - turns) * step
        for s in range(samples + 1):
            along = forward * axle * s / samples
            steps[k, s] = round(along * math.cos(angle) / spacing)
            rises[k, s] = along * math.sin(angle)
    ends = math.ceil(axle / spacing) + 1
    for j in range(ends, len(heights) - ends):
        for k in range(angles):
            height = -np.inf
            for s in range(samples + 1):
                height = max(height, heights[j + steps[k, s]] - rises[k, s])
            needed[k] = height
        for p in range(2 * steep + 1):
            for k in range(p, p + 2 * turns + 1):
                least[j, p] = min(least[j, p], needed[k])
                most[j, p] = max(most[j, p], needed[k])
    return least, most


@cached(njit)
def _can_stand(
    inner: FloatArray,
    outer: FloatArray,
    places: int,
    stride: int,
    margin: int,
    steep: int,
    turns: int,
    sizes: FloatArray,
) -> NDArray[np.bool_]:
    """Return whether the robot can stand at a place with a pitch, (places, 2·steep + 1).

    ``inner`` and ``outer`` are the ``inflated`` heights for a radius that is a little smaller, for
    what must not overlap, and a little larger, for what must touch. Places of the chassis centre
    are ``margin`` and every ``stride`` past it; flippers turn by up to ``turns`` steps. ``sizes``:
    spacing, half the chassis' axis, a flipper's axis, radius, shift of the centre of mass [m], and
    the step of angles [rad].
    """
    spacing, half, radius, shift, step = sizes[0], sizes[1], sizes[3], sizes[4], sizes[5]
    front_least, _ = _flipper(inner, 1, steep, turns, sizes)
    _, front_most = _flipper(outer, 1, steep, turns, sizes)
    rear_least, _ = _flipper(inner, -1, steep, turns, sizes)
    _, rear_most = _flipper(outer, -1, steep, turns, sizes)
    samples = math.ceil(2 * half / spacing)
    found = np.zeros((places, 2 * steep + 1), np.bool_)
    for p in range(2 * steep + 1):
        cos, sin = math.cos((p - steep) * step), math.sin((p - steep) * step)
        hinge = round(half * cos / spacing)
        for i in range(places):
            centre = margin + i * stride
            front, rear = centre + hinge, centre - hinge
            lowest = max(front_least[front, p] - half * sin, rear_least[rear, p] + half * sin)
            ahead, behind = front_most[front, p] - half * sin, rear_most[rear, p] + half * sin
            for s in range(samples + 1):
                along = half * (2 * s / samples - 1)
                at = centre + round(along * cos / spacing)
                lowest = max(lowest, inner[at] - along * sin)
                touched = along * cos + radius * sin  # x of the contact, from the centre
                if touched >= -shift:
                    ahead = max(ahead, outer[at] - along * sin)
                if touched <= shift:
                    behind = max(behind, outer[at] - along * sin)
            found[i, p] = lowest <= min(ahead, behind)
    return found


def _widened(possible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the poses within one pitch of the grid and within ``_TIPPING`` of possible ones."""
    wide = possible.copy()
    wide[:, 1:] |= possible[:, :-1]
    wide[:, :-1] |= possible[:, 1:]
    found = wide.copy()
    for away in range(1, round(_TIPPING / (_STRIDE * _SPACING)) + 1):
        found[away:] |= wide[:-away]
        found[:-away] |= wide[away:]
    return found


def _cheapest(cost: FloatArray) -> FloatArray:
    """Return the costs (P,) [rad] after a turn from whichever pitch is cheapest."""
    ahead = np.arange(len(cost), dtype=np.float64) * _ANGLE
    up = np.minimum.accumulate(cost - ahead) + ahead
    down = (np.minimum.accumulate((cost + ahead)[::-1]))[::-1] - ahead
    return np.asarray(np.minimum(up, down))


def episode_bound(env: FlipperEnv) -> float:
    """Return the bound of the episode that ``env.reset`` began [rad]."""
    finish, episode = env.drive.termination.finish, env.config.episode
    return static_bound(
        env.profile.points,
        env.robot,
        start=float(env.state.position[0]),
        finish=finish,
        pitch=env.state.pitch,
        clearance=episode.clearance if finish >= env.profile.end else math.inf,
        overturn=episode.overturn,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the bound on each terrain."""
    from flipperctl.requests.plan import scenes
    from flipperctl.requests.text import from_words

    parser = argparse.ArgumentParser(prog="python -m benchmarks.statics")
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as in terrain=ramp,stair")
    parser.add_argument("--episodes", type=int, default=20, help="of each terrain [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the episodes [0]")
    chosen = parser.parse_args(arguments)
    plugins.load([])
    words = [f"eval.episodes={chosen.episodes}", f"eval.seed={chosen.seed}", *chosen.overrides]
    for config, _ in scenes(from_words(words), None, "level"):
        env, bounds = FlipperEnv(config=config.environment()), []
        for seed in EvaluationSeeds.of(config.eval.seed, config.terrain).first(chosen.episodes):
            env.reset(seed=seed)
            bounds.append(episode_bound(env))
        print(
            f"{config.terrain.plugin_name}: {np.mean(bounds):.2f} rad, "
            f"{min(bounds):.2f} to {max(bounds):.2f} in {len(bounds)} episodes",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    entry.run(main)
