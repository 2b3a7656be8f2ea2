"""Loads on the chassis and the largest force of the tracks, in both engines."""

import math
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from flipperctl.api import Engine, FloatArray, Profile, Robot, Start, World
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.description import urdf
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar.joints import Budget, potential_energy
from flipperctl.sim.resting import resting

ENGINES = [Planar(), Planar(engine="plain"), Mujoco()]
NAMES = ["compiled", "plain", "mujoco"]
FLAT = Profile([(0.0, 0.0)])
ANGLE = math.radians(25)
SLOPE = Profile([(0.0, 0.0), (14.0, 14.0 * math.tan(ANGLE))])
NEEDED = 45 * 9.81 * math.sin(ANGLE)
"""Force that holds the robot on the slope [N]."""


def on_slope(engine: Engine, **robot: Any) -> World:
    placed = Robot(**robot)
    pose = resting(SLOPE, placed, 7.0, 0.0, 0.0, 1.0)
    assert pose is not None
    start = Start(7.0, height=pose[0], pitch=pose[1])
    world = engine.place(SLOPE, placed, start, np.random.default_rng(0))
    world.command(0.0, 0.0)
    return world


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
def test_weak_tracks_slide_back_and_strong_ones_climb(engine: Engine) -> None:
    full = 2.0 * 0.2 * math.cos(ANGLE)  # [m]
    strong = on_slope(engine, track_force=1.4 * NEEDED).advance(200)
    assert strong[-1, 0] - 7.0 == pytest.approx(full, abs=0.03)
    weak = on_slope(engine, track_force=0.8 * NEEDED).advance(200)
    # It slides by half of 0.2 g sin(25°), 0.83 m/s², times the time squared, once it has stopped.
    assert -1.7 < weak[-1, 0] - 7.0 < -0.2


def test_both_loops_of_the_plane_agree_on_loaded_robots_with_weak_tracks() -> None:
    robot = {"track_force": 1.1 * NEEDED, "payload": 8.0, "payload_x": -0.1, "payload_z": 0.3}
    compiled, plain = (on_slope(engine, **robot).advance(60) for engine in ENGINES[:2])
    assert compiled.tolist() == plain.tolist()


def test_a_force_that_is_never_reached_changes_nothing() -> None:
    for engine in ENGINES[:2]:
        free, strong = (on_slope(engine, track_force=f).advance(30) for f in (None, 50_000))
        assert free.tolist() == strong.tolist()


@pytest.mark.parametrize("engine", ENGINES[::2], ids=NAMES[::2])
def test_snapshots_keep_loads_and_limits(engine: Engine) -> None:
    robot = {"track_force": 1.1 * NEEDED, "payload": 8.0, "payload_x": -0.1, "payload_z": 0.3}
    world = on_slope(engine, **robot)
    world.advance(20)
    saved, at = world.save(), world.state()
    first = world.advance(20)
    world.load(saved)
    again = world.state()
    assert again.position == pytest.approx(at.position, abs=1e-12)
    assert again.velocity == pytest.approx(at.velocity, abs=1e-12)
    # The plane's snapshots lack contact impulses; those of MuJoCo continue bit for bit.
    tolerance = 0.0 if isinstance(engine, Mujoco) else 5e-3
    assert np.abs(world.advance(20) - first).max() <= tolerance


def tipping(engine: Engine, **load: float) -> FloatArray:
    """Return the last pose of a robot at the edge of a cliff, on belts that stand almost still."""
    cliff = Profile([(0.0, 0.0), (0.0, -2.0), (3.0, -2.0)])
    robot = Robot(track_speed=1e-6, **load)
    start = Start(-0.1, front=1.0, rear=1.0)
    world = engine.place(cliff, robot, start, np.random.default_rng(0))
    world.command(1.0, 1.0)
    return world.advance(100)[-1]


@pytest.mark.parametrize("engine", ENGINES[::2], ids=NAMES[::2])
def test_a_load_ahead_of_the_edge_tips_the_robot(engine: Engine) -> None:
    # 45 kg 0.1 m before the edge are 4.5 kg m; 10 kg 0.25 m ahead of it 2.5, and 25 kg 6.25.
    assert abs(tipping(engine)[2]) < 0.02
    assert abs(tipping(engine, payload=10.0, payload_x=0.35)[2]) < 0.02
    assert tipping(engine, payload=25.0, payload_x=0.35)[2] < -0.3
    assert abs(tipping(engine, payload=25.0, payload_x=-0.35)[2]) < 0.02


def test_a_robot_rests_where_its_load_is() -> None:
    heavy = Robot(payload=40.0, payload_x=0.5)
    with_edge = Profile([(0.0, 0.0), (0.0, -2.0), (3.0, -2.0)])
    assert resting(with_edge, Robot(), -0.1, 1.0, 1.0, 0.5) is not None
    assert resting(with_edge, heavy, -0.1, 1.0, 1.0, 0.5) is None


def test_masses_of_a_loaded_robot_by_hand() -> None:
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=-0.2)
    assert robot.carried_mass == 40.0
    assert robot.mass == 50.0
    assert robot.centre_of_mass == pytest.approx((0.05, -0.025))
    # 35 kg at 0.05 m and 5 kg at 0.35 m from the centre of mass, and half of both in height.
    ahead = 35 * 0.05**2 + 5 * 0.35**2
    assert robot.load_inertia == pytest.approx((ahead, ahead / 4))
    assert Robot().centre_of_mass == (0.0, 0.0)
    budget = Budget.of(robot, 10.0)
    assert (budget.ahead, budget.above) == pytest.approx((0.05, -0.025))
    states = np.zeros(18)
    states[2] = math.pi / 2  # nose up: what is ahead is above
    inertia = np.array([[40.0, 1.0], [5.0, 1.0], [5.0, 1.0]])
    assert potential_energy(states, inertia, 10.0, 0.05, 0.0) == pytest.approx(20.0)


def test_the_urdf_of_a_loaded_robot_has_its_inertia() -> None:
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=0.2)
    texts = (
        urdf(Mujoco().place(FLAT, one, Start(0.0), np.random.default_rng(0)))
        for one in (Robot(), robot)
    )
    bare, loaded = (ElementTree.fromstring(text).find("link/inertial") for text in texts)
    assert bare is not None
    assert loaded is not None
    (before, after) = (found.find("inertia").attrib for found in (bare, loaded))
    assert before["ixz"] == "0"
    assert float(after["ixz"]) == pytest.approx(-(35 * 5 / 40) * 0.4 * 0.2)
    assert float(after["iyy"]) - float(before["iyy"]) == pytest.approx(sum(robot.load_inertia))
    assert loaded.find("origin").attrib["xyz"] == "0.05 0 0.025"


def test_mujoco_has_the_inertia_of_the_load() -> None:
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=0.2)
    bare, loaded = (
        Mujoco().place(FLAT, one, Start(0.0), np.random.default_rng(0)).model.body("chassis")
        for one in (Robot(), robot)
    )
    assert loaded.mass == pytest.approx(40.0)
    assert loaded.ipos == pytest.approx([0.05, 0.0, 0.025])
    # Principal moments do not depend on axes: their sum grows by twice the load's.
    assert loaded.inertia.sum() - bare.inertia.sum() == pytest.approx(2 * sum(robot.load_inertia))
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, np.array(loaded.iquat))
    axes = turned.reshape(3, 3)
    tensor = axes @ np.diag(loaded.inertia) @ axes.T
    assert tensor[0, 2] == pytest.approx(-(35 * 5 / 40) * 0.4 * 0.2)
