"""Robot and ground as MJCF and URDF, read again by MuJoCo and by a parser of URDF."""

import math

import mujoco
import numpy as np
import pytest
from urdf_parser_py.urdf import URDF

from flipperctl.api import Profile, Robot, Start
from flipperctl.config import EvalConfig
from flipperctl.config.resolver import named_robot
from flipperctl.errors import ConfigError
from flipperctl.export.scene import export_scene, ground_file
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.description import ground_urdf, urdf
from flipperctl.sim.mujoco.ground import Box
from tests.cli.call import call, refused

ROBOT = named_robot("absolem")
FRONT, REAR = ("front_left", "front_right"), ("rear_left", "rear_right")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    config = EvalConfig(terrain="step", robot="absolem", sim="mujoco", episode={"start_angle": 0.3})
    export_scene(config, "mjcf", folder / "scene.xml")
    for _ in range(2):  # a scene of before is replaced
        found = export_scene(config, "urdf", folder / "robot.urdf")
    assert found["output"] == [str(folder / "robot.urdf"), str(folder / "robot_ground.urdf")]
    return folder


def test_mjcf_has_the_masses_lengths_limits_and_speed_of_the_robot(files):
    model = mujoco.MjModel.from_xml_path(str(files / "scene.xml"))
    assert model.body("chassis").mass[0] == pytest.approx(ROBOT.chassis_mass)
    for name in (*FRONT, *REAR):
        ahead = 1 if name in FRONT else -1
        flipper, joint = model.body(name), model.joint(name)
        assert flipper.mass[0] == pytest.approx(ROBOT.flipper_mass / 2)
        assert flipper.pos[0] == pytest.approx(ahead * ROBOT.hinge_offset)
        tip = model.geom(name.replace("_", "_tip_"))
        assert tip.pos[0] == pytest.approx(ahead * ROBOT.flipper_axle)
        assert tip.size[0] == pytest.approx(ROBOT.track_radius)
        # The engine's end stops are 1 mrad past the largest target.
        assert joint.range == pytest.approx([-ROBOT.angle_limit, ROBOT.angle_limit], abs=1.1e-3)
        assert model.actuator(name).forcerange[1] == pytest.approx(ROBOT.flipper_torque / 2)
    assert model.key("start").qpos[7:] == pytest.approx(0.3)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_step(model, data, nstep=100)
    begin = data.qpos[0]
    mujoco.mj_step(model, data, nstep=100)
    assert data.qpos[0] - begin == pytest.approx(0.2, rel=0.02)  # 0.5 s at 0.4 m/s


def test_urdf_has_the_masses_lengths_and_limits_of_the_robot(files):
    urdf = URDF.from_xml_string((files / "robot.urdf").read_bytes())
    assert urdf.get_root() == "base_link"
    assert urdf.link_map["base_link"].inertial.mass == pytest.approx(ROBOT.chassis_mass)
    assert set(urdf.joint_map) == {f"{name}_flipper" for name in (*FRONT, *REAR)}
    for name in (*FRONT, *REAR):
        joint, link = urdf.joint_map[f"{name}_flipper"], urdf.link_map[f"{name}_flipper_link"]
        ahead = 1 if name in FRONT else -1
        assert (joint.limit.lower, joint.limit.upper) == pytest.approx(
            (-ROBOT.angle_limit, ROBOT.angle_limit)
        )
        assert joint.limit.effort == pytest.approx(ROBOT.flipper_torque / 2)
        assert joint.limit.velocity == pytest.approx(ROBOT.flipper_speed)
        assert joint.axis == [0, 1, 0]
        assert joint.origin.xyz[0] == pytest.approx(ahead * ROBOT.hinge_offset)
        assert link.inertial.mass == pytest.approx(ROBOT.flipper_mass / 2)
        (tip,) = (c for c in link.collisions if hasattr(c.geometry, "radius"))
        assert tip.geometry.radius == pytest.approx(ROBOT.track_radius)
        assert tip.origin.xyz[0] == pytest.approx(ahead * ROBOT.flipper_axle)


def test_mujoco_reads_the_urdf_with_the_inertia_and_the_signs_of_ros(files):
    text = (files / "robot.urdf").read_text()
    # MuJoCo would weld the chassis to the world and drop its mass.
    kept = "<mujoco><compiler fusestatic='false'/></mujoco></robot>"
    model = mujoco.MjModel.from_xml_string(text.replace("</robot>", kept))
    scene = mujoco.MjModel.from_xml_path(str(files / "scene.xml"))
    inertia = np.sort(scene.body("chassis").inertia)
    assert np.sort(model.body("base_link").inertia) == pytest.approx(inertia, rel=1e-5)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.2
    mujoco.mj_kinematics(model, data)
    reach = ROBOT.flipper_axle * math.sin(0.2)
    for name in (*FRONT, *REAR):
        link = model.body(f"{name}_flipper_link").id
        tip = [g for g in range(model.ngeom) if model.geom_bodyid[g] == link][-1]
        height = data.geom_xpos[tip][2]
        assert height == pytest.approx(-reach if name in FRONT else reach)  # front: down


def test_the_ground_of_the_urdf_is_that_of_the_mjcf(files):
    ground = mujoco.MjModel.from_xml_path(str(ground_file(files / "robot.urdf")))
    scene = mujoco.MjModel.from_xml_path(str(files / "scene.xml"))
    of_ground = scene.geom_bodyid == 0
    assert ground.ngeom == of_ground.sum() == 2
    assert ground.geom_size == pytest.approx(scene.geom_size[of_ground], rel=1e-5)
    assert ground.geom_pos == pytest.approx(scene.geom_pos[of_ground], rel=1e-5)


def test_slopes_of_the_ground_rise_ahead():
    text = ground_urdf([Box((0.0, 0.0, 0.0), (1.0, 2.0, 0.1), 0.2)])
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ahead = data.geom_xmat[0].reshape(3, 3)[:, 0]
    assert ahead == pytest.approx(np.array([math.cos(0.2), 0, math.sin(0.2)]))


def test_the_command_chooses_robot_and_engine(tmp_path):
    done = call("export", "urdf", "terrain=flat", "robot=absolem", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "flat.urdf and flat_ground.urdf: flat, seed 0, 1 boxes" in done.out
    assert f'mass value="{ROBOT.chassis_mass:g}' in (tmp_path / "flat.urdf").read_text()
    text = "onnx: name a policy, as in: flipperctl export onnx runs/first"
    assert text in refused("export", "onnx", cwd=tmp_path)
    text = "--seed is for mjcf, urdf and mcap, not onnx"
    assert text in refused("export", "onnx", "--seed", "1", cwd=tmp_path)
    with pytest.raises(ConfigError, match="planar has no model in 3-D to write; sim=mujoco"):
        export_scene(EvalConfig(terrain="flat"), "mjcf", tmp_path / "x.xml")


def test_the_urdf_of_a_loaded_robot_has_its_inertia():
    robot, flat = Robot(payload=5.0, payload_x=0.4, payload_z=0.2), Profile([(0.0, 0.0)])
    bare, loaded = (
        URDF.from_xml_string(
            urdf(Mujoco().place(flat, one, Start(0.0), np.random.default_rng(0))).encode()
        )
        .link_map["base_link"]
        .inertial
        for one in (Robot(), robot)
    )
    assert bare.inertia.ixz == 0
    assert loaded.inertia.ixz == pytest.approx(-(35 * 5 / 40) * 0.4 * 0.2)
    assert loaded.inertia.iyy - bare.inertia.iyy == pytest.approx(sum(robot.load_inertia))
    assert loaded.origin.xyz == [0.05, 0, 0.025]
