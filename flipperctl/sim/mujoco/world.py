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
from flipperctl.core.targets import alike, by_joint
from flipperctl.errors import NonFiniteError
from flipperctl.sim.ground import OVERLAP, height_at
from flipperctl.sim.mujoco.compiled import (
    HINGES,
    Axis,
    Scene,
    ahead,
    faster,
    has_fallen,
    left,
    pitch_of,
    roll_of,
    run,
    yaw_of,
)
from flipperctl.sim.mujoco.ground import GROUND_WIDTH, ROUGH_MARGIN, lay
from flipperctl.sim.mujoco.model import ROBOT_GROUP, Model, add_scenery, build, specify
from flipperctl.sim.mujoco.settings import MujocoSettings

if TYPE_CHECKING:
    from flipperctl.sim.mujoco.shown import Camera, Shown


def _orientation(forward: Axis, left: Axis) -> FloatArray:
    """Return the rotation from frame R to world by the chassis' x and y axes, (3, 3)."""
    (a, b, c), (d, e, f) = forward, left
    return np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])


def _quaternion(pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) of a chassis that stands on a slope of ``pitch`` and turned on it [rad].

    ``pitch`` is nose up positive; ``yaw`` is the turn to the left about the slope's normal.
    """
    cos, sin = math.cos(pitch / 2), math.sin(pitch / 2)
    w, z = math.cos(yaw / 2), math.sin(yaw / 2)
    return cos * w, 0.0 - sin * z, 0.0 - sin * w, cos * z  # 0.0 minus: no -0.0 on level ground


_SIDES = 1.0, -1.0  # left and right, as in ``Model.sides``
_AVERAGING = 0.1
"""Time over which normal forces are averaged for the motors' limit; contacts hop [s]."""


class Tracks:
    """The belts on both sides of one robot."""

    def __init__(self, built: Model, robot: Robot, sim: MujocoSettings) -> None:
        """Drive the belts of the ``built`` model."""
        self._model, self._belts, self._sides = built
        self._gain, self._speed, self._friction = sim.heading_gain, robot.track_speed, sim.friction
        self._force, self._places = robot.track_force, self._sides.astype(np.intp)
        self.share = 1.0
        """Share of the robot's speed at which the belts run, from -1 to 1 [-]."""
        self.are_limited = self._force is not None
        """Whether the motors limit the belts' force."""
        # A robot at rest presses half of its weight on each side.
        weight = robot.mass * sim.gravity
        self.pressed = 0.0, 0.0
        """Averaged normal forces on the left and on the right tracks [N]."""
        self.restore((weight / 2, weight / 2))

    def run(self, share: float) -> None:
        """Run the belts at a share of the robot's speed, from -1 to 1."""
        self.share = share
        self._model.geom_surfacevel[:] = share * self._belts

    def speeds(self, pose: FloatArray) -> FloatArray:
        """Return the speeds of the left and the right belts at this pose, (2,) [m/s]."""
        difference = self._speed * faster(pose, self._gain)
        return self.share * np.array([self._speed + difference, self._speed - difference])

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
        sides = np.add.reduce(self._sides[data.contact.geom[active]], axis=1)  # the ground has 0
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
            usable = (min(self._friction, self._force / 2 / max(n, 1e-9)) for n in pressed)
            # A contact has the larger friction of its two shapes. Place -1, the right, is the last.
            self._model.geom_friction[:, 0] = np.array([0.0, *usable])[self._places]


_ORDER = [0, 2, 1, 3]
"""Place in ``HINGES`` of the flippers at the front left, front right, rear left and rear right, and
the other way round."""
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
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
        (placing,) = rng.spawn(1)  # so that the scenery changes no other random number
        self.strips, self.ground = lay(profile, sim, rng)
        # The scene, compiled, with belts that the loop steers
        spec = specify(self.ground, robot, sim)
        add_scenery(spec, profile, sim, placing)
        built = build(spec)
        self.model, self._tracks = built.model, Tracks(built, robot, sim)
        self.data = mujoco.MjData(self.model)
        # What the compiled loop reads and writes. It calls C's mj_step with the structs' addresses,
        # which MuJoCo gives as _address alone; its public mj_step costs a call of Python a substep.
        model, data = built.model, self.data
        self._scene = Scene(
            model=model._address,
            data=data._address,
            pose=data.qpos,
            velocities=data.ctrl,
            torques=data.actuator_force,
            moving=model.geom_surfacevel,
            belts=built.belts,
            sides=built.sides,
            substeps=round(SAMPLE_PERIOD / sim.substep),
            rate=robot.flipper_speed,
            gain=sim.heading_gain,
            up=(0.0, math.sin(sim.handed * sim.lateral_slope), math.cos(sim.lateral_slope)),
            half_width=GROUND_WIDTH / 2,
            roll_limit=sim.roll_limit,
        )
        # Sums over the episode, and what pictures need once they are asked for
        self._samples = 0
        self._sums = np.zeros(2)  # the servos' work [J], the roll's changes [rad]
        self._shown: Shown | None = None
        self._cameras: dict[tuple[int, int], Camera] = {}
        self._ground_is_placed = False
        # The pose of the start, moved off ground that is only in 3-D
        self.command(*alike((start.front, start.rear), len(robot.joints)))
        pose = self.data.qpos
        pose[:3] = start.x, side, height_at(start, profile, robot)
        pose[3:7] = _quaternion(start.pitch, yaw)
        pose[HINGES] = [start.front, start.rear] * 2
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
        # The edges of oblique ground reach back on one side.
        outer = sim.flipper_offset + sim.track_width / 2 + abs(float(pose[1]))
        nearest = start.x - farther - outer * abs(sim.slant)
        while (depth := self.penetration()) > OVERLAP and pose[0] > nearest:
            pose[0] = max(nearest, pose[0] - depth)

    def command(self, *targets: float) -> None:
        """Set the target angle of each joint in frame R, (J,) [rad]; both flippers of a pair."""
        limited = list(map(self.robot.clip, targets))
        self._targets = np.repeat(limited, len(_ORDER) // len(limited))[_ORDER]

    def _angles(self, hinges: FloatArray) -> FloatArray:
        """Return the angles of the joints, (…, J), by those of the hinges, (…, 4) [rad].

        The angle of a pair is the mean of its sides.
        """
        shape = *hinges.shape[:-1], len(self.robot.joints), -1
        return np.asarray(hinges[..., _ORDER].reshape(shape).mean(axis=-1))

    def run_belts(self, share: float) -> None:
        """Run the belts at a share of the robot's speed, from -1 to 1."""
        self._tracks.run(share)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the poses at their ends, (S, 3 + J).

        See ``flipperctl.api.World``.
        """
        poses, done, over = np.empty((samples, 3 + len(_ORDER))), 0, False
        while done < samples and not over:
            # The normal forces of a sample limit the friction of the next one.
            until = done + 1 if self._tracks.are_limited else samples
            state = self._targets, self._tracks.share, self._sums
            count, over = run(self._scene, *state, poses[done:until], tuple(limits))
            done += count
            self._tracks.limit(self.data)
        self._samples += done
        self._check_divergence()
        return np.column_stack([poses[:done, :3], self._angles(poses[:done, 3:])])

    def _check_divergence(self) -> None:
        if any(self.data.warning[bad].number for bad in _BAD):
            raise NonFiniteError(
                f"sim=mujoco diverged before time {self.time:.2f} s; a smaller sim.substep than "
                f"{self.sim.substep:g} s may help"
            )

    def ended(self) -> Outcome | None:
        """Return OVERTURNED if the robot rolled over sideways or left the ground at its side."""
        return Outcome.OVERTURNED if has_fallen(self._scene) else None

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
        return float(pitch_of(self.data.qpos, self._scene.up))

    @property
    def roll(self) -> float:
        """Angle of the chassis' y axis, to the left, above the horizontal [rad]."""
        return float(roll_of(self.data.qpos, self._scene.up))

    @property
    def yaw(self) -> float:
        """Heading of the chassis from the x axis, to the left positive [rad]."""
        return float(yaw_of(self.data.qpos))

    def state(self) -> RobotState:
        """Return the current state."""
        data, pose = self.data, self.data.qpos
        return RobotState(
            position=np.array(self.position),
            pitch=self.pitch,
            **by_joint(self._angles(pose[HINGES]).tolist()),
            velocity=data.qvel[[0, 2]],
            pitch_rate=-float(data.qvel[4]),
            time=self.time,
            roll=self.roll,
            yaw=self.yaw,
            side=float(pose[1]),
            side_velocity=float(data.qvel[1]),
            orientation=_orientation(ahead(pose), left(pose)),
            belts=self._tracks.speeds(pose),
        )

    def flipper_work(self) -> float:
        """Return the work of the servos since the start, where braking counts as driving does [J].

        It is the sum over samples and flippers of |mean torque times the flipper's turn|.
        """
        return float(self._sums[0])

    def roll_variation(self) -> float:
        """Return the sum of the absolute roll changes from sample to sample [rad]."""
        return float(self._sums[1])

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
            self._shown = Shown(self.profile, self.robot, self.sim, self.strips, self.model)
        if (width, height) not in self._cameras:
            self._cameras[width, height] = Camera(self._shown, width, height)
        self._shown.pose(self.data.qpos, self.robot.track_speed * self.time)
        return self._cameras[width, height]

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot for ``load``, from which runs continue bit for bit."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state, self._targets, self._samples, self._sums.copy(), self._tracks.pressed

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        state, self._targets, self._samples, sums, pressed = saved
        self._sums = sums.copy()
        self._tracks.restore(pressed)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
