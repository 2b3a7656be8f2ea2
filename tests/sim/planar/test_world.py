"""The physics against numbers worked by hand."""

import math

import numpy as np
import pymunk
import pytest

from flipperctl.api import Limits, Profile, Robot, Start
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar import world as world_module
from flipperctl.sim.planar.compiled import CompiledLoop
from flipperctl.sim.planar.joints import Budget
from flipperctl.sim.planar.plain import GROUND, TRACK, Belt, PlainLoop
from flipperctl.sim.planar.world import PlanarWorld

FLAT = Profile([(0.0, 0.0)])
UNBOUNDED = Budget(gravity=0.0, servos=0.0, belts=0.0, tolerance=math.inf)
STILL = 1e-9  # [m/s] belts that brake: the smallest speed that the settings allow


def run(world: PlanarWorld, seconds: float) -> None:
    for _ in range(round(100 * seconds)):
        world.advance()


def turn(world: PlanarWorld, angle: float, lift: float) -> None:
    """Turn the whole robot about the ground below its centre, then lift it."""
    x, _ = world.position
    pivot = pymunk.Vec2d(x, world.profile.height(x))
    for body in world.space.bodies:
        body.position = pivot + (body.position - pivot).rotated(angle) + (0.0, lift)
        body.angle += angle


def on_slope(degrees: float, friction: float) -> PlanarWorld:
    """Return a braking robot that stands on a slope of 120 m length."""
    slope = math.radians(degrees)
    rise = 60.0 * math.tan(slope)
    ground = Profile([(-60.0, -rise), (60.0, rise)])
    world = PlanarWorld(ground, Robot(track_speed=STILL), Planar(friction=friction), Start(0.0))
    turn(world, slope, 0.0)
    run(world, 0.5)
    return world


def crossing(height: float, friction: float) -> str:
    """Return the outcome of the rule controller at one riser."""
    env = FlipperEnv(
        terrain={"name": "step", "low": height, "high": height},
        sim={"friction": friction},
        episode={"start_noise": 0},
    )
    return episode(env)["outcome"]


def episode(env: FlipperEnv) -> dict:
    """Return the last info of an episode under the rule controller."""
    rule = resolver.create("controller", "okada", "controller").build()
    env.reset(seed=0)
    while True:
        *_, terminated, truncated, info = env.step(rule.act(env.perception))
        if terminated or truncated:
            return info


@pytest.mark.parametrize("speed", [0.05, 0.2, 1.0])
def test_drives_at_the_belt_speed_on_the_flat(speed: float) -> None:
    world = PlanarWorld(FLAT, Robot(track_speed=speed), Planar(), Start(-5.0))
    run(world, 1.0)  # it starts at rest
    start = world.position[0]
    run(world, 5.0)
    assert (world.position[0] - start) / 5.0 == pytest.approx(speed, rel=0.01)


def test_rests_at_the_height_of_its_tracks() -> None:
    world = PlanarWorld(FLAT, Robot(track_speed=STILL), Planar(), Start(0.0))
    run(world, 1.0)
    assert world.position == pytest.approx((0.0, 0.1), abs=2e-4)
    assert world.pitch == pytest.approx(0.0, abs=1e-4)


# atan 0.5 = 26.57°
@pytest.mark.parametrize("degrees", [20.0, 25.0])
def test_holds_on_a_slope_below_the_angle_of_friction(degrees: float) -> None:
    world = on_slope(degrees, friction=0.5)
    before = np.array(world.position)
    run(world, 2.0)
    assert np.linalg.norm(np.array(world.position) - before) < 1e-3
    assert math.degrees(world.pitch) == pytest.approx(degrees, abs=0.1)


# g (sin a - 0.5 cos a): 9.81 · (0.46947 - 0.44147) = 0.2747, 9.81 · (0.52992 - 0.42402) = 1.0388
@pytest.mark.parametrize(("degrees", "acceleration"), [(28.0, 0.2747), (32.0, 1.0388)])
def test_slides_on_a_slope_above_the_angle_of_friction(degrees: float, acceleration: float) -> None:
    world = on_slope(degrees, friction=0.5)
    before = np.linalg.norm(world.state().velocity)
    run(world, 1.0)
    gained = np.linalg.norm(world.state().velocity) - before
    assert gained == pytest.approx(acceleration, rel=0.03)
    assert world.state().velocity[0] < 0  # downhill


# At the edge of a cliff, the front pair level and the rear pair up at π/3. Seen from the chassis
# centre, a pair's centre of gravity lies 0.28 + 0.168 = 0.448 m ahead and
# 0.28 + 0.168 · cos(π/3) = 0.364 m behind; pairs of m kg and the chassis of 35 kg balance at
# m (0.448 - 0.364) / (35 + 2 m): 9.3 mm ahead for 5 kg, 22.4 mm for 20 kg.
@pytest.mark.parametrize(("mass", "ahead"), [(5.0, 0.0093), (20.0, 0.0224)])
def test_tips_over_an_edge_where_statics_says(mass: float, ahead: float) -> None:
    cliff = Profile([(0.0, 0.0), (0.0, -2.0)])
    robot = Robot(track_speed=STILL, flipper_mass=mass)
    pitches = []
    for overhang in (-0.005, 0.005):  # [m] of the centre of gravity beyond the edge
        world = PlanarWorld(cliff, robot, Planar(), Start(overhang - ahead, 0.0, math.pi / 3))
        run(world, 2.0)
        pitches.append(world.pitch)
    assert pitches[0] == pytest.approx(0.0, abs=1e-3)
    assert pitches[1] < -0.5


# A tilted robot rocks a little when its other end slaps down.
@pytest.mark.parametrize(("tilt", "rebound"), [(0.0, 0.02), (0.3, 0.1)])
def test_a_drop_loses_energy_and_does_not_bounce(tilt: float, rebound: float) -> None:
    robot, sim = Robot(track_speed=STILL), Planar()
    world = PlanarWorld(FLAT, robot, sim, Start(0.0))
    turn(world, tilt, lift=0.5)

    def energy() -> float:
        return sum(
            body.mass * 9.81 * body.position.y
            + body.mass * body.velocity.length**2 / 2
            + body.moment * body.angular_velocity**2 / 2
            for body in world.space.bodies
        )

    energies, heights = [energy()], []
    for _ in range(200):
        world.advance()
        energies.append(energy())
        heights.append(world.position[1])
    # The engine lets bodies in contact sink in by at most one substep's way, here
    # √(2 · 9.81 · 0.5) m/s · 5 ms = 15.7 mm, and pushes them out again: 45 · 9.81 · 0.0157 = 6.9 J
    # of the 45 · 9.81 · 0.5 = 221 J that the drop sets free.
    assert max(np.diff(energies)) < 6.9
    assert energies[-1] == pytest.approx(45 * 9.81 * 0.1, rel=0.01)  # at rest on the tracks
    landed = int(np.argmax(np.array(heights) < 0.11))
    assert max(heights[landed:]) < 0.1 + rebound


@pytest.mark.parametrize(("height", "friction"), [(0.2, 0.7), (0.4, 1.0)])
def test_the_belt_climbs_a_riser(height: float, friction: float) -> None:
    assert crossing(height, friction) == "reached"


@pytest.mark.parametrize("terrain", ["step", "paper_step", "paper_stair"])
def test_both_engines_give_the_same_episodes_bit_for_bit(terrain: str) -> None:
    plain, compiled = (
        FlipperEnv(terrain=terrain, sim={"engine": engine}) for engine in ("plain", "compiled")
    )
    assert episode(plain)["metrics"] == episode(compiled)["metrics"]
    assert plain.state.time == compiled.state.time > 10.0
    assert np.array_equal(plain.transition.path, compiled.transition.path)
    assert np.array_equal(plain.state.position, compiled.state.position)


@pytest.mark.parametrize("engine", ["plain", "compiled"])
@pytest.mark.parametrize("limits", [Limits(x=-4.9), Limits(angle=1e-9)], ids=["x", "pitch"])
def test_both_engines_stop_at_the_sample_that_reaches_a_limit(engine: str, limits: Limits) -> None:
    world, other = (
        PlanarWorld(FLAT, Robot(), Planar(engine=engine), Start(-5.0)) for _ in range(2)
    )
    poses = world.advance(100, limits)
    every = [other.advance()[0].tolist() for _ in poses]
    assert 0 < len(poses) < 100
    assert world.time == pytest.approx(0.01 * len(poses))
    assert poses.tolist() == every
    state = world.state()
    assert poses[-1].tolist() == [*world.position, world.pitch, state.front, state.rear]
    assert other.position == world.position
    assert abs(world.pitch) >= limits.angle or world.position[0] >= limits.x


@pytest.mark.parametrize("engine", ["plain", "compiled"])
def test_both_engines_continue_past_the_finish_while_an_end_is_too_high(engine: str) -> None:
    world = PlanarWorld(FLAT, Robot(), Planar(engine=engine), Start(0.0))
    low = Limits(x=-1.0, top=0.09, half=0.28)  # the chassis rests at 0.1 m
    assert len(world.advance(30, low)) == 30
    assert len(world.advance(30, low._replace(top=0.11))) == 1


def test_one_constant_surface_velocity_would_stall_at_the_riser(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Constant(PlainLoop):
        def drive(self, belt: Belt) -> None:
            for shape in self._space.shapes:
                if shape.collision_type == TRACK:
                    shape.surface_velocity = (-belt.speed, 0.0)

    monkeypatch.setattr(world_module, "_loop", lambda engine: Constant)
    level = PlanarWorld(FLAT, Robot(), Planar(), Start(-5.0))
    run(level, 6.0)
    assert level.position[0] == pytest.approx(-3.8, abs=0.02)  # on the flat nothing shows
    assert crossing(0.4, friction=1.0) == "stuck"


@pytest.mark.parametrize("loop", [PlainLoop, CompiledLoop])
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
    pull: tuple[float, float],
    velocity: tuple[float, float],
    loop: type[PlainLoop | CompiledLoop],
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
    loop(space, (track, track, track), Belt(0.2, math.inf), UNBOUNDED, 0.005, 2).run(
        np.empty((100, 5)), Limits()
    )
    assert track.velocity == pytest.approx(velocity, abs=1e-6)


def test_penetration_is_the_depth_in_the_ground() -> None:
    world = PlanarWorld(FLAT, Robot(), Planar(), Start(0.0))
    turn(world, 0.0, lift=-0.03)
    assert world.penetration() == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize("terrain", ["paper_step", "paper_stair"])
def test_half_the_substep_changes_the_pitch_variation_little(terrain: str) -> None:
    coarse, fine = (
        episode(FlipperEnv(terrain, sim={"substep": s}, episode={"start_noise": 0}))
        for s in (0.005, 0.0025)
    )
    assert coarse["outcome"] == fine["outcome"] == "reached"
    variations = [info["metrics"]["pitch_variation"] for info in (coarse, fine)]
    assert variations[0] == pytest.approx(variations[1], rel=0.05)


def test_equal_inputs_give_bit_identical_trajectories() -> None:
    stair = resolver.create("terrain", "paper_stair", "terrain").generate(np.random.default_rng(0))

    def trajectory() -> list[tuple[float, ...]]:
        world = PlanarWorld(stair, Robot(), Planar(), Start(-1.0))
        states = []
        for decision in range(40):
            world.command(0.8 * math.sin(decision), 0.8 * math.cos(decision))
            run(world, 0.6)
            s = world.state()
            states.append((*s.position, *s.velocity, s.pitch, s.front, s.rear, s.pitch_rate))
        return states

    first = trajectory()
    assert first == trajectory()
    assert first[-1][0] > 0.0  # it got as far as the stairs
