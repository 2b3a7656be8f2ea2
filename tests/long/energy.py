"""Energy, end stops, hinges and penetration over random episodes on many kinds of ground.

``python -m tests.long.energy --episodes 500 --seed 1`` plays 500 episodes of random actions on each
terrain and prints a table; it fails if any sample gains more energy than the drives can give, if a
flipper passes its stop too far, if the robot sinks in, or if a state is not finite. Episode i has
the seed 100,000 · seed + i.
"""

import argparse
import sys
from dataclasses import dataclass

import numpy as np
from pymunk import PivotJoint

from flipperctl.api import ACTIONS, NO_LIMITS, FloatArray, Limits
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError
from flipperctl.sim.planar.compiled import TOLERANCE, Budget
from flipperctl.sim.planar.world import PlanarWorld

TERRAINS = (
    *("step", "stair", "paper_step", "paper_stair", "building_stair", "ramp", "pallet", "rubble"),
    *("wave", "uplift", "plum", "gap", "rail", "curb_and_ramp"),
)
BOUNDS = {"excess": TOLERANCE + 0.1, "overshoot": 0.2, "penetration": 0.05, "non_finite": 0}
"""Largest values that are no violation; see ``Balance``."""
_START = {"start_noise": 0.1, "start_angle_noise": 0.1}


@dataclass(frozen=True)
class Balance:
    """The largest values of one episode."""

    terrain: str
    seed: int
    outcome: str
    gain: float
    """Kinetic and potential energy gained in one sample [J]."""
    excess: float
    """The same, beyond what servos and belts can give in that sample [J]."""
    overshoot: float
    """Flipper angle past its limit [rad]."""
    gap: float
    """Distance between the two sides of a hinge, at decisions [m]."""
    penetration: float
    """Overlap with the ground, at decisions [m]."""
    non_finite: int
    """1 if a state was not finite."""


class Meter:
    """Advances a world sample by sample and measures the robot after each."""

    def __init__(self, world: PlanarWorld) -> None:
        self._world, self._advance = world, world.advance
        self._bodies = (world._chassis, world._front, world._rear)
        self._hinges = [c for c in world.space.constraints if isinstance(c, PivotJoint)]
        self.energies, self.work, self.angle = [self._energy()], [0.0], 0.0
        world.advance = self.advance

    def _energy(self) -> float:
        """Return the kinetic and the potential energy of the robot [J]."""
        gravity = self._world.sim.gravity
        return sum(
            body.mass * gravity * body.position.y
            + body.mass * body.velocity.length**2 / 2
            + body.moment * body.angular_velocity**2 / 2
            for body in self._bodies
        )

    def gap(self) -> float:
        """Return the larger distance between the two sides of a hinge [m]."""
        return max(
            (h.b.local_to_world(h.anchor_b) - h.a.local_to_world(h.anchor_a)).length
            for h in self._hinges
        )

    def advance(self, samples: int = 1, limits: Limits = NO_LIMITS) -> FloatArray:
        """Advance as the world does."""
        poses = []
        for _ in range(samples):
            poses.append(self._advance(1, limits)[0])
            self.energies.append(self._energy())
            self.work.append(self._world._loop.work)
            self.angle = max(self.angle, *np.abs(poses[-1][3:]))
            if limits.reached(*poses[-1][:3]):
                break
        return np.array(poses)


def measure(env: FlipperEnv, seed: int, actions: int | None = None) -> Balance:
    """Play an episode of random actions and return what was measured.

    ``actions``: seed of the actions, without it that of the episode.
    """
    rng = np.random.default_rng(seed if actions is None else actions)
    env.reset(seed=seed)
    world = env.drive.world.unguarded
    meter = Meter(world)
    gap = penetration = 0.0
    outcome = ""
    while not outcome:
        try:
            *_, info = env.step(int(rng.integers(len(ACTIONS))))
        except NonFiniteError:
            outcome = "not finite"
            break
        gap = max(gap, meter.gap())
        penetration = max(penetration, world.penetration())
        outcome = str(info.get("outcome", ""))
    gains = np.diff(meter.energies)
    budget = Budget.of(env.robot, world.sim.gravity)
    drives = np.minimum(meter.work[1:], budget.belts) + budget.servos
    return Balance(
        env.config.terrain.plugin_name,
        seed,
        outcome,
        float(gains.max()),
        float((gains - drives).max()),
        float(meter.angle) - env.robot.angle_limit,
        gap,
        penetration,
        int(outcome == "not finite"),
    )


def violations(found: list[Balance]) -> list[Balance]:
    """Return the episodes that exceed a bound."""
    return [b for b in found if any(not getattr(b, k) <= v for k, v in BOUNDS.items())]


def table(found: list[Balance]) -> str:
    """Return the largest values on each terrain, each with the seed to see it again."""
    columns = ("gain", "excess", "overshoot", "gap", "penetration")
    units = ("J", "J", "rad", "mm", "mm")
    lines = [
        f"{'terrain':<15}{'episodes':>9}"
        + "".join(f"{f'{c} [{u}] (seed)':>24}" for c, u in zip(columns, units, strict=True))
        + f"{'not finite':>12}{'violations':>12}"
    ]
    for terrain in dict.fromkeys(b.terrain for b in found):
        own = [b for b in found if b.terrain == terrain]
        line = f"{terrain:<15}{len(own):>9}"
        for column, unit in zip(columns, units, strict=True):
            worst = max(own, key=lambda b, c=column: getattr(b, c))
            value = getattr(worst, column) * (1000 if unit == "mm" else 1)
            line += f"{f'{value:.3f} ({worst.seed})':>24}"
        lines.append(f"{line}{sum(b.non_finite for b in own):>12}{len(violations(own)):>12}")
    return "\n".join(lines)


def run(episodes: int, terrains: list[str], seed: int) -> int:
    """Play the episodes, print the table and return the exit code."""
    found: list[Balance] = []
    for terrain in terrains:
        env = FlipperEnv(terrain, episode=_START)
        found += [measure(env, 100_000 * seed + i) for i in range(episodes)]
        print(f"{len(found)} of {episodes * len(terrains)}, {terrain}", file=sys.stderr)
    print(table(found))
    wrong = violations(found)
    for balance in wrong:
        print(f"violation: {balance}")
    print(f"{len(found)} episodes, {len(wrong)} violations of {BOUNDS}")
    return 1 if wrong else 0


def main() -> int:
    """Parse the command line and run the episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=500, help="on each terrain")
    parser.add_argument("--terrains", default=",".join(TERRAINS), help="names, with commas")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    return run(chosen.episodes, chosen.terrains.split(","), chosen.seed)


if __name__ == "__main__":
    sys.exit(main())
