"""Energy, end stops and penetration over an episode of random actions, and their bounds."""

from dataclasses import dataclass

import numpy as np

from flipperctl.api import ACTIONS, NO_LIMITS, FloatArray, Limits
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError
from flipperctl.sim.planar.compiled import TOLERANCE, Budget
from flipperctl.sim.planar.world import PlanarWorld

BOUNDS = {"excess": TOLERANCE + 0.1, "overshoot": 0.2, "penetration": 0.05, "non_finite": 0}
"""Largest values that are no violation; see ``Balance``."""


@dataclass(frozen=True)
class Balance:
    """The largest values of one episode."""

    gain: float
    """Kinetic and potential energy gained in one sample [J]."""
    excess: float
    """The same, beyond what servos and belts can give in that sample [J]."""
    overshoot: float
    """Flipper angle past its limit [rad]."""
    penetration: float
    """Overlap with the ground, at decisions [m]."""
    non_finite: int
    """1 if a state was not finite."""


class Meter:
    """Advances a world sample by sample and measures the robot after each."""

    def __init__(self, world: PlanarWorld) -> None:
        self._world, self._advance = world, world.advance
        self._bodies = (world._chassis, world._front, world._rear)
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


def measure(env: FlipperEnv, seed: int, actions: int) -> Balance:
    """Play an episode of actions drawn with the seed ``actions``; return what was measured."""
    rng = np.random.default_rng(actions)
    env.reset(seed=seed)
    world = env.drive.world.unguarded
    meter = Meter(world)
    penetration = 0.0
    outcome = ""
    while not outcome:
        try:
            *_, info = env.step(int(rng.integers(len(ACTIONS))))
        except NonFiniteError:
            outcome = "not finite"
            break
        penetration = max(penetration, world.penetration())
        outcome = str(info.get("outcome", ""))
    gains = np.diff(meter.energies)
    budget = Budget.of(env.robot, world.sim.gravity)
    drives = np.minimum(meter.work[1:], budget.belts) + budget.servos
    return Balance(
        float(gains.max()),
        float((gains - drives).max()),
        float(meter.angle) - env.robot.angle_limit,
        penetration,
        int(outcome == "not finite"),
    )


def violations(found: list[Balance]) -> list[Balance]:
    """Return the episodes that exceed a bound."""
    return [b for b in found if any(not getattr(b, k) <= v for k, v in BOUNDS.items())]
