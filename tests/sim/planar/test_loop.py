"""The planar engine's loop; ``tests/sim/test_physics.py`` has the physics of both engines."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymunk
import pytest

from flipperctl.api import ACTIONS, NO_LIMITS, FloatArray, Limits, Robot, Start
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, NonFiniteError
from flipperctl.sim.planar import Planar, compiled, world
from flipperctl.sim.planar.compiled import GROUND, TOLERANCE, TRACK, Belt, Budget, CompiledLoop
from flipperctl.sim.planar.world import PlanarWorld
from tests.sim.planar.plain import PlainLoop
from tests.sim.test_physics import FLAT, NEEDED, PLANAR, episode, resting_on_slope

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
    world = env.drive.world.of_engine
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


UNBOUNDED = Budget(gravity=0.0, servos=0.0, belts=0.0, tolerance=math.inf)
LOOPS = [PlainLoop, CompiledLoop]


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], list[Any]]:
    """Return what a function returns in worlds that step by the plain and the compiled loop."""

    def played(function: Callable[[], Any]) -> list[Any]:
        found = []
        for loop in LOOPS:
            monkeypatch.setattr(world, "CompiledLoop", loop)
            found.append(function())
        return found

    return played


@pytest.mark.parametrize("terrain", ["step", "paper_stair"])
def test_both_loops_give_the_same_episodes_bit_for_bit(both: Any, terrain: str) -> None:
    def played() -> list[Any]:
        env = FlipperEnv(terrain)
        metrics, state = episode(env)["metrics"], env.state
        assert state.time > 10.0
        path = env.transition.path.tolist()
        return [metrics, state.time, state.position.tolist(), path, env.transition.flipper_work]

    plain, compiled = both(played)
    assert plain == compiled


def test_a_load_adds_its_inertia_and_servos_hold_the_angles_that_the_start_gave() -> None:
    loaded = Robot(payload=5.0, payload_x=0.4, payload_z=-0.2)
    # Pitched and in the air, so that nothing else turns the flippers; no command has come yet.
    start = Start(0.0, front=0.2, rear=-0.1, height=1.0, pitch=0.3)
    bare, heavy = (PlanarWorld(FLAT, one, Planar(), start) for one in (Robot(), loaded))
    # 35 kg at 0.05 m and 5 kg at 0.35 m from the centre of mass, and half of both in height
    added = 1.25 * (35 * 0.05**2 + 5 * 0.35**2)
    assert heavy._chassis.moment - bare._chassis.moment == pytest.approx(added)
    assert bare.advance(10)[-1, 3:] == pytest.approx([0.2, -0.1], abs=1e-3)


def test_both_loops_bound_the_impulses_that_a_contact_caches(
    both: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The weight of 45 kg is 45 · 9.81 · 0.005 = 2.2 N s in a substep, over all contacts.
    monkeypatch.setattr(world, "Belt", lambda speed, largest, grip: Belt(speed, 0.2, grip))

    def driven() -> Any:
        env = FlipperEnv("flat")
        env.reset(seed=0)
        for _ in range(3):
            env.step(4)
        return env.drive.poses.tolist()

    plain, found = both(driven)
    assert found == plain


def test_both_loops_agree_on_loaded_robots_with_weak_tracks(both: Any) -> None:
    robot = {"track_force": 1.1 * NEEDED, "payload": 8.0, "payload_x": -0.1, "payload_z": 0.3}
    plain, compiled = both(lambda: resting_on_slope(PLANAR, **robot).advance(60).tolist())
    assert plain == compiled
    free, strong = (resting_on_slope(PLANAR, track_force=f).advance(30) for f in (None, 50_000))
    assert free.tolist() == strong.tolist()  # a force that is never reached changes nothing


@pytest.mark.parametrize("limits", [Limits(x=-4.9), Limits(angle=1e-9)], ids=["x", "pitch"])
def test_both_loops_stop_at_the_sample_that_reaches_a_limit(both: Any, limits: Limits) -> None:
    def stopped() -> list[list[float]]:
        world, other = (PlanarWorld(FLAT, Robot(), Planar(), Start(-5.0)) for _ in range(2))
        poses = world.advance(100, limits)
        assert 0 < len(poses) < 100
        assert poses.tolist() == [other.advance()[0].tolist() for _ in poses]
        assert world.time == pytest.approx(0.01 * len(poses))
        state = world.state()
        assert poses[-1].tolist() == [*world.position, world.pitch, state.front, state.rear]
        assert abs(world.pitch) >= limits.angle or world.position[0] >= limits.x
        return poses.tolist()

    plain, compiled = both(stopped)
    assert plain == compiled


def test_both_loops_continue_past_the_finish_while_an_end_is_too_high(both: Any) -> None:
    low = Limits(x=-1.0, top=0.09, half=0.28)  # the chassis rests at 0.1 m

    def advanced() -> list[int]:
        placed = PlanarWorld(FLAT, Robot(), Planar(), Start(0.0))
        return [len(placed.advance(30, at)) for at in (low, low._replace(top=0.11))]

    assert both(advanced) == [[30, 1]] * 2


@pytest.mark.parametrize("loop", LOOPS)
# A belt that runs forward below runs up a face before it, back along a ceiling, down a face behind.
@pytest.mark.parametrize(
    ("pull", "velocity"),
    [
        ((0.0, -9.81), (0.2, 0.0)),
        ((9.81, 0.0), (0.0, 0.2)),
        ((0.0, 9.81), (-0.2, 0.0)),
        ((-9.81, 0.0), (0.0, -0.2)),
    ],
    ids=["ground", "face ahead", "ceiling", "face behind"],
)
def test_the_belt_runs_along_the_face_that_it_touches(
    pull: tuple[float, float], velocity: tuple[float, float], loop: type
) -> None:
    space = pymunk.Space()
    space.gravity = pull
    track = pymunk.Body(1.0, 1e9)  # it hardly turns
    wheel = pymunk.Circle(track, 0.1)
    outward = pymunk.Vec2d(*pull).normalized()
    along = outward.perpendicular() * 5.0
    face = pymunk.Segment(space.static_body, outward * 0.1 + along, outward * 0.1 - along, 0.0)
    wheel.friction = face.friction = 1.0
    wheel.collision_type, face.collision_type = TRACK, GROUND
    space.add(track, wheel, face)
    driven = loop(space, (track, track, track), Belt(0.2, math.inf), UNBOUNDED, 0.005, 2)
    driven.run(np.empty((100, 5)), Limits())
    assert track.velocity == pytest.approx(velocity, abs=1e-6)


@pytest.mark.parametrize(
    "name", ["NORMAL", "SURFACE", "COUNT", "NORMAL_IMPULSE", "TANGENT_IMPULSE"]
)
def test_an_offset_that_moved_is_refused_before_machine_code_uses_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled.check_layout()
    compiled.check_layout.cache_clear()
    monkeypatch.setattr(compiled, name, getattr(compiled, name) + 1)
    with pytest.raises(ConfigError, match=r"cannot be used with pymunk .*install another pymunk"):
        FlipperEnv("flat").reset(seed=0)
    monkeypatch.undo()
    compiled.check_layout.cache_clear()
    compiled.check_layout()


# No energy from nowhere


def balance(terrain: str, seed: int, actions: int) -> Balance:
    start = {"start_noise": 0.1, "start_angle_noise": 0.1}
    return measure(FlipperEnv(terrain, episode=start), seed, actions)


# The first three were thrown away from between two faces before the bounds were introduced: they
# gained 2,146, 1,696 and 171 J in 10 ms.
@pytest.mark.parametrize(
    ("terrain", "seed", "actions"),
    [("plum", 100441, 100441), ("rail", 100466, 100467), ("pallet", 100479, 100479), ("gap", 3, 3)],
)
def test_no_sample_gains_more_energy_than_the_drives_give(
    terrain: str, seed: int, actions: int
) -> None:
    found = balance(terrain, seed, actions)
    assert violations([found]) == []
    assert found.excess <= compiled.TOLERANCE + 1e-6
    assert found.gain < 5.5  # servos 1.75, belts at most 2.65, tolerance 1


def test_energies_by_hand() -> None:
    # 2 kg at 3 m with (3, 4) m/s and 5 rad/s of 0.4 kg m²: 25 + 5 J, and 2 · 10 · 3 = 60 J.
    states, inertia = np.array([0.0, 3.0, 0.1, 3.0, 4.0, 5.0]), np.array([[2.0, 0.4]])
    assert compiled.kinetic_energy(states, inertia) == pytest.approx(30.0)
    assert compiled.potential_energy(states, inertia, 10.0, 0.0, 0.0) == pytest.approx(60.0)
    factor = compiled.slowdown(30.0, 22.5)  # a quarter is left
    assert factor == pytest.approx(0.5)
    states[3:] *= factor
    assert compiled.kinetic_energy(states, inertia) == pytest.approx(7.5)
    assert compiled.slowdown(30.0, 40.0) == 0.0
    # A loaded chassis with its nose up: what is ahead is above.
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=-0.2)
    budget = Budget.of(robot, 10.0)
    assert (budget.ahead, budget.above) == pytest.approx((0.05, -0.025))
    states = np.zeros(18)
    states[2] = math.pi / 2
    inertia = np.array([[40.0, 1.0], [5.0, 1.0], [5.0, 1.0]])
    assert compiled.potential_energy(states, inertia, 10.0, 0.05, 0.0) == pytest.approx(20.0)


def test_a_gain_that_no_drive_gave_is_taken_from_the_velocities(
    both: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "TOLERANCE", -1e6)  # as if all of it came from nowhere

    def state() -> list[float]:
        placed = PlanarWorld(FLAT, Robot(), Planar(), Start(0.0))
        placed.advance(20)
        return [*placed.state().velocity.tolist(), placed.state().pitch_rate]

    assert both(state) == [pytest.approx([0.0, 0.0, 0.0])] * 2
