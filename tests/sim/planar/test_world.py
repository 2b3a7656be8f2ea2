"""The planar engine: its two loops, its belts; ``tests/sim/test_physics.py`` has its physics."""

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
from tests.sim.test_physics import crossing, episode

FLAT = Profile([(0.0, 0.0)])
UNBOUNDED = Budget(gravity=0.0, servos=0.0, belts=0.0, tolerance=math.inf)


def run(world: PlanarWorld, seconds: float) -> None:
    for _ in range(round(100 * seconds)):
        world.advance()


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
