"""The MuJoCo world: a robot with two main tracks and four flippers on an extruded profile.

In: a profile, the robot, the engine's settings and a start. Out: the robot's pose every 10 ms, and
its whole ``RobotState`` on request. The pitch and the roll are measured against gravity, positions
in the ground's frame; both agree unless ``lateral_slope`` is set.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    CameraImage,
    FloatArray,
    Limits,
    Outcome,
    Profile,
    Robot,
    RobotState,
    Start,
    View,
)
from flipperctl.errors import NonFiniteError
from flipperctl.sim.ground import OVERLAP, height_at
from flipperctl.sim.mujoco.ground import GROUND_WIDTH, ROUGH_MARGIN, lay
from flipperctl.sim.mujoco.model import ROBOT_GROUP, Model, add_scenery, build, specify
from flipperctl.sim.mujoco.settings import MujocoSettings

if TYPE_CHECKING:
    from flipperctl.sim.mujoco.shown import Camera, Shown

Axis = tuple[float, float, float]


def _orientation(ahead: Axis, left: Axis) -> FloatArray:
    """Return the rotation from frame R to world by the chassis' x and y axes, (3, 3)."""
    (a, b, c), (d, e, f) = ahead, left
    return np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])


def _quaternion(pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of a chassis that stands on a slope of ``pitch`` and turned on it [rad].

    ``pitch`` is nose up positive; ``yaw`` is the turn to the left about the slope's normal.
    """
    cos, sin = math.cos(pitch / 2), math.sin(pitch / 2)
    w, z = math.cos(yaw / 2), math.sin(yaw / 2)
    return cos * w, 0.0 - sin * z, 0.0 - sin * w, cos * z  # 0.0 minus: no -0.0 on level ground


_SIDES = 1.0, -1.0  # left and right, as in ``Model.sides``
_LARGEST_STEER = 0.5
"""Largest difference of a belt's speed from the robot's by steering, as a fraction [-]."""
_STEER_AHEAD = 1.0  # steering aims at the middle of the ground this far ahead [m]
_AVERAGING = 0.1
"""Time over which normal forces are averaged for the motors' limit; contacts hop [s]."""


class Tracks:
    """The belts on both sides of one robot."""

    def __init__(self, built: Model, robot: Robot, sim: MujocoSettings) -> None:
        """Drive the belts of the ``built`` model."""
        self._model, self._belts, self._sides = built
        self._gain, self._speed, self._friction = sim.heading_gain, robot.track_speed, sim.friction
        self._force = robot.track_force
        if self._force is not None:  # a contact has the larger friction of its two shapes
            self._model.geom_friction[self._sides == 0, 0] = 0.0
        self._share = 1.0
        # A robot at rest presses half of its weight on each side.
        weight = robot.mass * sim.gravity
        self.pressed = 0.0, 0.0
        """Averaged normal forces on the left and on the right tracks [N]."""
        self.restore((weight / 2, weight / 2))

    def steer(self, yaw: float, side: float) -> None:
        """Set the belts' speeds for a heading [rad] and a distance beside the middle [m]."""
        if self._gain:
            faster = self._faster(yaw, side)
            belts = self._belts * (1.0 + faster * self._sides)[:, None]
            self._model.geom_surfacevel[:] = self._share * belts

    def run(self, share: float) -> None:
        """Run the belts at a share of the robot's speed, from -1 to 1."""
        self._share = share
        self._model.geom_surfacevel[:] = share * self._belts

    def _faster(self, yaw: float, side: float) -> float:
        """Return by which fraction the left belts run faster than the robot's speed."""
        steer = self._gain * (yaw + side / _STEER_AHEAD)
        return min(_LARGEST_STEER, max(-_LARGEST_STEER, steer))

    def speeds(self, yaw: float, side: float) -> FloatArray:
        """Return the speeds of the left and the right belts, (2,) [m/s]."""
        faster = self._speed * self._faster(yaw, side)
        return self._share * np.array([self._speed + faster, self._speed - faster])

    def limit(self, data: Any) -> None:
        """Scale the friction of each side so that its motor can supply the force of its belts.

        It is called after each sample, for the next one. A belt that its load holds slips as one
        without grip; each side has half of ``robot.track_force``.
        """
        if self._force is None:
            return
        # Contacts that the solver left out have no force.
        active = data.contact.efc_address >= 0
        normal = data.efc_force[data.contact.efc_address[active]]  # (C,) [N]
        sides = self._sides[data.contact.geom[active]].sum(axis=1)  # (C,), the ground has 0
        rate = SAMPLE_PERIOD / _AVERAGING
        left, right = (
            (1 - rate) * before + rate * float(normal[sides == side].sum())
            for side, before in zip(_SIDES, self.pressed, strict=True)
        )
        self.restore((left, right))

    def restore(self, pressed: tuple[float, float]) -> None:
        """Take the averaged normal forces [N], and set the friction that follows from them."""
        self.pressed = pressed
        if self._force is not None:
            for side, force in zip(_SIDES, pressed, strict=True):
                usable = min(self._friction, self._force / 2 / max(force, 1e-9))
                self._model.geom_friction[self._sides == side, 0] = usable


_SERVO_RATE = 25.0  # velocity that a servo demands for each rad of its angle's error [1/s]
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_HINGES = slice(7, 11)  # of qpos, after the free joint
_RAY_GROUPS = np.array([group != ROBOT_GROUP for group in range(6)], np.uint8)
_BAD = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


def _ignore(text: str) -> None:
    """Drop MuJoCo's warnings, which it otherwise writes to a file in the working directory.

    Divergence is detected from the warning counts in MuJoCo's data.
    """


class MujocoWorld:
    """One robot on one profile; rebuilt for every episode, so that replays are bit-identical."""

    def __init__(
        self,
        profile: Profile,
        robot: Robot,
        sim: MujocoSettings,
        start: Start,
        rng: np.random.Generator,
    ) -> None:
        """Place the robot at ``start``; without a height, it rests level on flippers or chassis.

        Yaw, offset and roughness are sampled from ``rng``.
        """
        mujoco.set_mju_user_warning(_ignore)
        self.robot, self.sim, self.profile = robot, sim, profile
        # Variation 0 leaves the generator as it is, and with it the episodes of earlier results.
        if sim.variation:
            rng = np.random.default_rng([sim.variation, *rng.integers(2**32, size=4).tolist()])
        # The order of the draws is part of an episode: yaw, offset, then roughness.
        yaw = sim.yaw * rng.uniform(-1.0, 1.0)
        side = sim.offset * rng.uniform(-1.0, 1.0)
        self._half_width = GROUND_WIDTH / 2
        (placing,) = rng.spawn(1)  # so that the scenery changes no other random number
        self.strips, self.ground = lay(profile, sim, rng)
        # The scene, compiled, with belts that the loop steers
        spec = specify(self.ground, robot, sim)
        add_scenery(spec, profile, sim, placing)
        built = build(spec)
        self.model, self._tracks = built.model, Tracks(built, robot, sim)
        self.data = mujoco.MjData(self.model)
        # Sums over the episode, and what pictures need once they are asked for
        self._substeps = round(SAMPLE_PERIOD / sim.substep)
        self._up = np.array([0.0, math.sin(sim.lateral_slope), math.cos(sim.lateral_slope)])
        self._samples = 0
        self._work = 0.0
        self._shown: Shown | None = None
        self._cameras: dict[tuple[int, int], Camera] = {}
        self._ground_is_placed = False
        # The pose of the start, moved off ground that is only in 3-D
        self._targets = np.array([start.front, start.rear, start.front, start.rear])
        pose = self.data.qpos
        pose[:3] = start.x, side, height_at(start, profile, robot)
        pose[3:7] = _quaternion(start.pitch, yaw)
        pose[_HINGES] = self._targets
        self._clear(start, yaw)

    def _clear(self, start: Start, yaw: float) -> None:
        """Move the robot off what it overlaps where a straight one on the profile would not.

        Past the first edge it goes up, off rough patches and turned edges. Ahead of it, back, by no
        more than the corner of a turned robot and what reaches onto rough ground are farther ahead.
        """
        pose, robot, sim = self.data.qpos, self.robot, self.sim
        # A robot that starts on the obstacle moves up.
        if start.height is not None:
            while (depth := self.penetration()) > OVERLAP:
                pose[2] += depth
            return
        # One that starts ahead of it moves back, by no more than this.
        farther = corner = (sim.flipper_offset + sim.track_width / 2) * abs(math.sin(yaw))
        if sim.roughness:
            tip = robot.hinge_offset + robot.flipper_axle * math.cos(start.front)
            rough = self.profile.start - ROUGH_MARGIN
            farther += max(0.0, start.x + corner + (tip + robot.track_radius) - rough)
        nearest = start.x - farther
        while (depth := self.penetration()) > OVERLAP and pose[0] > nearest:
            pose[0] = max(nearest, pose[0] - depth)

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R, left and right alike [rad]."""
        self._targets = np.array([front, rear, front, rear])

    def run_belts(self, share: float) -> None:
        """Run the belts at a share of the robot's speed, from -1 to 1."""
        self._tracks.run(share)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the pose at the end of each, (S, 5).

        See ``flipperctl.api.World``.
        """
        poses = np.empty((samples, 5))
        for sample in range(samples):
            self._drive()
            before = self.data.qpos[_HINGES].copy()
            torque = self._step()
            # The normal forces of this sample limit the friction of the next one.
            self._tracks.limit(self.data)
            turned = self.data.qpos[_HINGES] - before
            self._work += float(np.abs(torque * turned).sum())
            self._samples += 1
            x, z = self.position
            pitch = self.pitch
            poses[sample] = x, z, pitch, *self._angles()
            # The poses end with the sample that ends the run.
            if limits.reached(x, z, pitch) or self.ended() is not None:
                poses = poses[: sample + 1]
                break
        self._check_divergence()
        return poses

    def _step(self) -> FloatArray:
        """Simulate a sample; return the flippers' mean torques, since they chatter [N m]."""
        total = np.zeros(len(self._targets))
        for _ in range(self._substeps):
            mujoco.mj_step(self.model, self.data)
            total += self.data.actuator_force
        return total / self._substeps

    def _drive(self) -> None:
        """Set the velocities of the servos and the speeds of the belts for one sample."""
        angles = self.data.qpos[_HINGES]
        limit, rate = self.robot.angle_limit, self.robot.flipper_speed
        errors = np.minimum(np.maximum(self._targets, -limit), limit) - angles
        self.data.ctrl[:] = np.minimum(np.maximum(_SERVO_RATE * errors, -rate), rate)
        self._tracks.steer(self.yaw, float(self.data.qpos[1]))

    def _check_divergence(self) -> None:
        if any(self.data.warning[bad].number for bad in _BAD):
            raise NonFiniteError(
                f"sim=mujoco diverged before time {self.time:.2f} s; a smaller sim.substep than "
                f"{self.sim.substep:g} s may help"
            )

    def ended(self) -> Outcome | None:
        """Return OVERTURNED if the robot rolled over sideways or left the ground at its side."""
        fell = abs(self.data.qpos[1]) > self._half_width
        return Outcome.OVERTURNED if fell or abs(self.roll) >= self.sim.roll_limit else None

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]."""
        return self._samples * SAMPLE_PERIOD

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""
        pose = self.data.qpos
        return float(pose[0]), float(pose[2])

    @property
    def pitch(self) -> float:
        """Angle of the chassis' x axis above the horizontal, past ±π/2 if it points back [rad]."""
        x, y, z = self._axis(0)
        _, up_y, up_z = self._up.tolist()
        rise = y * up_y + z * up_z
        return math.atan2(rise, math.copysign(math.sqrt(max(0.0, 1.0 - rise * rise)), x))

    @property
    def roll(self) -> float:
        """Angle of the chassis' y axis, to the left, above the horizontal [rad]."""
        _, y, z = self._axis(1)
        _, up_y, up_z = self._up.tolist()
        return math.asin(min(1.0, max(-1.0, y * up_y + z * up_z)))

    @property
    def yaw(self) -> float:
        """Heading of the chassis from the x axis, to the left positive [rad]."""
        x, y, _ = self._axis(0)
        return math.atan2(y, x)

    def _axis(self, index: int) -> Axis:
        """Return the chassis' x (0) or y (1) axis in world; after ``mj_step``, ``xmat`` is old."""
        w, x, y, z = self.data.qpos[3:7].tolist()
        if index == 0:
            return 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        return 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)

    def _angles(self) -> tuple[float, float]:
        """Return the angles of the front and the rear pair, the means of both sides [rad]."""
        front_left, rear_left, front_right, rear_right = self.data.qpos[_HINGES].tolist()
        return (front_left + front_right) / 2, (rear_left + rear_right) / 2

    def state(self) -> RobotState:
        """Return the current state."""
        data, ahead, left = self.data, self._axis(0), self._axis(1)
        front, rear = self._angles()
        yaw, side = math.atan2(ahead[1], ahead[0]), float(data.qpos[1])
        return RobotState(
            position=np.array(self.position),
            pitch=self.pitch,
            front=front,
            rear=rear,
            velocity=data.qvel[[0, 2]],
            pitch_rate=-float(data.qvel[4]),
            time=self.time,
            roll=self.roll,
            yaw=yaw,
            side=side,
            side_velocity=float(data.qvel[1]),
            orientation=_orientation(ahead, left),
            belts=self._tracks.speeds(yaw, side),
        )

    def flipper_work(self) -> float:
        """Return the work of the servos since the start, where braking counts as driving does [J].

        It is the sum over samples and flippers of |mean torque times the flipper's turn|.
        """
        return self._work

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""
        mujoco.mj_fwdPosition(self.model, self.data)
        return max(0.0, -float(np.min(self.data.contact.dist, initial=0.0)))

    def cast_rays(self, origin: FloatArray, directions: FloatArray, reach: float) -> FloatArray:
        """Return the distance from ``origin`` to the ground along each direction, (R,) [m].

        See ``flipperctl.api.RayWorld``.
        """
        if not self._ground_is_placed:  # before the first step, MuJoCo's data has no poses
            mujoco.mj_kinematics(self.model, self.data)
            self._ground_is_placed = True
        count = len(directions)
        shapes, distances = np.empty(count, np.int32), np.empty(count)
        rays = np.ascontiguousarray(directions, np.float64).ravel()
        start = np.asarray(origin, np.float64)
        # Rays pass through the robot; the instrument itself computes where they meet it.
        scene = self.model, self.data, start, rays, _RAY_GROUPS, True, -1
        mujoco.mj_multiRay(*scene, shapes, distances, None, count, reach)
        return np.where((shapes >= 0) & (distances <= reach), distances, np.inf)

    def draw(self, width: int, height: int) -> NDArray[np.uint8]:
        """Return a picture of the current state from ``sim.view``, (H, W, 3).

        Raises:
            RequestError: the picture is too large, or the machine has neither EGL nor OSMesa.
            FlipperctlError: the installed library cannot draw.
        """
        if self.sim.view != "outside":
            return self.look(self.sim.view, width, height).pixels
        return self._camera(width, height).draw()

    def look(self, view: View, width: int, height: int) -> CameraImage:
        """Return what a camera on the robot shows; it raises what ``draw`` raises."""
        return self._camera(width, height).look(view)

    def _camera(self, width: int, height: int) -> Camera:
        """Return a camera for pictures of this size, which shows the current state."""
        from flipperctl.sim.mujoco.shown import Camera, Shown

        if self._shown is None:
            self._shown = Shown(self.robot, self.sim, self.strips, self.model)
        if (width, height) not in self._cameras:
            self._cameras[width, height] = Camera(self._shown, width, height)
        self._shown.pose(self.data.qpos, self.robot.track_speed * self.time)
        return self._cameras[width, height]

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot for ``load``, from which runs continue bit for bit."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state, self._targets, self._samples, self._work, self._tracks.pressed

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        state, self._targets, self._samples, self._work, pressed = saved
        self._tracks.restore(pressed)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
