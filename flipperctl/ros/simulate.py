"""A simulated robot on topics of ROS 2: its devices publish, its motors obey whoever commands.

In: a scene and the robot's devices; commands on topics. Out: clouds, attitudes, joints, belts,
poses and the clock, as a real robot's drivers publish them; the outcome of each episode. In real
time by default, faster or slower by a rate, or in lockstep: then each sample waits for the node's
answer, so that an episode is repeatable. Motors without a command stand.

A node that follows these topics needs nothing of flipperctl. ``simulation/begin`` tells that an
episode begins, and when by the clock of the robot, or in lockstep by that of this machine. So a
node knows what is still on its way of the last episode. It is repeated until the node answers it on
``simulation/ready``. In lockstep ``simulation/tick`` holds the time of a sample, and how many
messages of the four devices there were in this episode; the node answers with a command of that
stamp.
"""

from __future__ import annotations

import heapq
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flipperctl.api import Command, Measured, Perception, RobotState, Simulator, World, action_index
from flipperctl.config import EvalConfig
from flipperctl.core.lidar.body import attitude
from flipperctl.core.lidar.messages import Belts, Inertial, Scan
from flipperctl.core.targets import alike, angles_of, by_joint
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros.messages import LIDAR, Messages
from flipperctl.ros.wire import Wire, open_wire
from flipperctl.runtime.devices import Devices
from flipperctl.runtime.states import CommandWatch

_EPOCH = 1_000_000.0
"""Clock at the begin of the first episode in lockstep [s]."""
_BETWEEN = 1000.0
"""Time between two begins there [s]."""
_APART = 1.0
"""Least time between two episodes otherwise [s]."""
_DISCOVERY = 10.0
"""Longest time in which another node is expected to listen [s]."""
_ANSWER = 20.0
"""Longest time in which a node in lockstep is expected to answer a sample [s]."""
_TOGETHER = 0.01
"""Difference of the joints of a pair up to which they turn together [rad]."""
_PERIOD = 0.02
"""Time between two commands to the motors [s]."""
_SAMPLE = 0.01
"""That time in lockstep, a sample of the simulation [s]."""
_BEHIND = 0.1
"""How far the simulation may be behind real time, as old as a robot's joints may be [s]."""


@dataclass(frozen=True)
class Link:
    """How the robot is simulated on its topics."""

    rate: float = 1.0
    """Simulated seconds in a real one."""
    lockstep: bool = False
    sim_time: bool = False
    """Whether stamps are of the simulator's clock, for nodes with ``use_sim_time``."""
    delay: float = 0.0
    """Time by which messages of the devices come late [s]."""
    jitter: float = 0.0
    """Largest further delay of a message, uniform [s]."""
    loss: float = 0.0
    """Share of the messages of the devices that never come [-]."""
    clock_step: tuple[float, float] | None = None
    """Time of an episode at which the robot's clock steps, and by how much [s]."""

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.lockstep and (self.clock_step or self.rate != 1.0):
            raise RequestError("--lockstep has no rate and no step of the clock")

    @property
    def simulated_clock(self) -> bool:
        """Whether stamps are not those of this machine's clock."""
        return self.sim_time or self.lockstep or self.rate != 1.0


def step_of(text: str | None) -> tuple[float, float] | None:
    """Return time and size of a step of the clock [s], as in ``3:-5``."""
    if text is None:
        return None
    try:
        at, seconds = map(float, text.split(":"))
        if 0 <= at < math.inf and math.isfinite(seconds):
            return at, seconds
    except ValueError:
        pass
    raise RequestError(f"--clock-step {text}: a time and a step in s are allowed, as in 3:-5")


@dataclass
class Numbers:
    """What an episode over topics was like."""

    behind: float = 0.0
    """Most that the simulation was behind real time [s]."""
    answers: list[float] = field(default_factory=list)
    """Times from the sending of a cloud to the first command made after its stamp [s]."""
    sent: Counter[str] = field(default_factory=Counter)
    commands: int = 0
    diagnoses: Counter[str] = field(default_factory=Counter)
    """Fault, or else state → how many diagnoses told it."""
    used: list[tuple[float, float]] = field(default_factory=list)
    """Time of the machine, and processor time that the node told, of each diagnosis [s]."""

    @property
    def processor_share(self) -> float | None:
        """Share of a core that the node used; None without two diagnoses that tell it [-]."""
        if len(self.used) < 2:
            return None
        (begun, before), (ended, after) = self.used[0], self.used[-1]
        return (after - before) / (ended - begun)


class TopicRobot(Observer):
    """The devices and motors of one robot on topics; the environment's observer and policy."""

    every = 1
    risk_sign = None

    def __init__(
        self,
        wire: Wire,
        devices: Devices,
        config: EvalConfig,
        link: Link,
        tell: Callable[[str], object] = lambda text: None,
    ) -> None:
        """``tell`` receives what is odd in the commands, once each kind."""
        self._tell, self._told = tell, set[str]()
        self._wire, self.devices, self._config, self._link = wire, devices, config, link
        self.command_period = _SAMPLE if link.lockstep else _PERIOD
        self._make = Messages(devices=devices, origin=_EPOCH, double=link.lockstep)
        self._rng = np.random.default_rng(0)
        self._watch, self._heard = CommandWatch(), threading.Condition()
        self._ready: float | None = None
        self._answered = -math.inf  # stamp of the newest command [s]
        self._late: list[tuple[float, int, str, Any]] = []  # when it comes, and what [s]
        self.numbers, self._count, self._order = Numbers(), 0, 0
        self._base = self._now = _EPOCH  # the clock at the episode's begin, and now [s]
        self._when = 0.0  # time of the episode [s]
        self._zero: float | None = None  # real time of the episode's begin [s]
        self._cloud: tuple[float | None, float] = (None, 0.0)  # sent, and its stamp
        self._speed, self._ticked = 0.0, -math.inf
        self.answered = False
        """Whether a node has answered that it knows of the episode."""
        signs = devices.signs
        self._signs = signs.front, signs.rear
        self._publish = self._publishers()
        self._subscribe()

    def _publishers(self) -> Mapping[str, Callable[[Any], None] | None]:
        names = self.devices.topics
        kinds = {
            names.clouds: "sensor_msgs/msg/PointCloud2",
            names.imu: "sensor_msgs/msg/Imu",
            names.joints: "sensor_msgs/msg/JointState",
            names.belts: "std_msgs/msg/Float64",
            "odom": "nav_msgs/msg/Odometry",
            "/tf": "tf2_msgs/msg/TFMessage",
            "/clock": "rosgraph_msgs/msg/Clock",
            "simulation/begin": "std_msgs/msg/Float64",
            "simulation/tick": "std_msgs/msg/Float64MultiArray",
        }
        best = {names.clouds} if not self._link.lockstep else set()
        publishers = {
            t: self._wire.publisher(t, k, best_effort=t in best) for t, k in kinds.items()
        }
        publishers["/tf_static"] = self._wire.publisher("/tf_static", kinds["/tf"], latched=True)
        return publishers

    def _subscribe(self) -> None:
        names, subscribe = self.devices.topics, self._wire.subscribe
        subscribe(names.joint_command, "sensor_msgs/msg/JointState", self._on_command)
        subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", self._on_diagnosis)
        subscribe("simulation/ready", "std_msgs/msg/Float64", self._on_ready)

    # What others publish

    def _on_command(self, message: Any) -> None:
        """Take a command: angles of the flippers, if any, and the speed of the belts."""
        joints, count = self.devices.joints, len(self._config.robot.joints)
        values = dict(zip(message.name, message.position, strict=False))
        speeds = dict(zip(message.name, message.velocity, strict=False))
        # The flippers that turn together
        groups: list[Sequence[str]] = [joints.front, joints.rear]
        if count > len(groups):
            groups = [[name] for group in groups for name in group]
        targets: list[float] = []
        for names, sign in zip(groups, alike(self._signs, count), strict=True):
            angles = [
                (-1 if name.startswith("-") else 1) * values.get(name.lstrip("-"), math.nan)
                for name in names
            ]
            targets.append(sign * joints.scale * sum(angles) / len(angles))
            self._remark(message.name, names, [joints.scale * angle for angle in angles])
        speed = speeds.get("belts", 0.0)
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        with self._heard:
            goal = tuple(targets) if all(map(math.isfinite, targets)) else None
            valid, now = self.devices.limits.valid_for, self._now
            self._watch.take(now, stamp, valid, speed != 0, goal)
            self._speed = speed
            self.numbers.commands += 1
            self._answered = max(self._answered, stamp)
            sent, stamped = self._cloud
            if sent is not None and stamp >= stamped:
                self.numbers.answers.append(time.monotonic() - sent)
                self._cloud = None, 0.0
            self._heard.notify_all()

    def _remark(self, there: Sequence[str], names: Sequence[str], angles: Sequence[float]) -> None:
        """Tell of commands by which the joints of a pair do not turn together."""
        pair, command = ", ".join(names), self.devices.topics.joint_command
        text = ""
        if any(map(math.isnan, angles)) and {name.lstrip("-") for name in names} & {*there}:
            text = f"{command} has angles of a part of the joints {pair}: none counts"
        elif max(angles) - min(angles) > _TOGETHER:
            text = f"{command} turns the joints {pair} apart: the simulated ones take the mean"
        if text and text not in self._told:
            self._told.add(text)
            self._tell(text)

    def _on_diagnosis(self, message: Any) -> None:
        values = {entry.key: entry.value for entry in message.status[0].values}
        if "state" in values:
            self.numbers.diagnoses[values.get("fault") or values["state"]] += 1
        if "processor" in values:
            self.numbers.used.append((time.monotonic(), float(values["processor"])))

    def _on_ready(self, message: Any) -> None:
        with self._heard:
            self._ready = message.data
            self._heard.notify_all()

    # An episode

    def prepare(self, number: int) -> None:
        """Tell that an episode begins, and wait for the node.

        Raises:
            FlipperctlError: in lockstep, no node answers.
        """
        self._late.clear()
        begin = time.time()  # which no other simulator has told before
        if self._link.simulated_clock:
            begin = max(begin, self._now + _APART)
        self._base = _EPOCH + _BETWEEN * number if self._link.lockstep else begin
        self._zero, self._cloud = None, (None, 0.0)
        self._now, self._when, self._speed = self._base, 0.0, 0.0
        self._watch, self._answered = CommandWatch(), -math.inf
        until = time.monotonic() + _DISCOVERY
        with self._heard:
            self._ready = None
            while self._ready != begin and time.monotonic() < until:
                self._send("simulation/begin", self._make.number(begin))
                self._heard.wait(0.2)
            self.answered = self._ready == begin
            if not self.answered and self._link.lockstep:
                raise FlipperctlError("lockstep: no node has answered on simulation/ready")
            self.numbers, self._count = Numbers(), 0
        sensor: Any = self._config.perception
        mount = self._make.mount(sensor.mount_x, sensor.mount_z, sensor.mount_axis)
        self._send("/tf_static", mount)

    def reset(self, simulator: Simulator) -> None:
        """Do nothing: whoever commands begins by ``simulation/begin``."""

    def act(self, p: Perception) -> int:
        """Return the action without effect; the commands count."""
        return action_index(0, 0)

    def command(self, world: World) -> Command:
        """Return what the newest command lets the motors do."""
        state = world.state()
        self._tick()
        with self._heard:
            drives, angles = self._watch.drives(self._now), self._watch.angles(self._now)
        angles = angles_of(state) if angles is None else angles
        belts = self._speed / self._config.robot.track_speed if drives else 0.0
        return Command(**by_joint(angles), belts=max(-1.0, min(1.0, belts)))

    def stopped(self, world: World) -> None:
        """Publish a sample: clock, pose and joints."""
        state = world.state()
        self._pace(state.time)
        self._send("/clock", self._make.clock(state.time))
        joints = self._make.joint_state(state.time, *angles_of(state))
        self._measure(self.devices.topics.joints, joints)
        self._send("odom", self._make.odometry(state))
        self._send("/tf", self._make.transforms(state))
        self._flush()

    def measured(self, measured: Measured) -> None:
        """Publish a measurement of an instrument."""
        when, value, names = measured.time, measured.value, self.devices.topics
        self._pace(when)
        if isinstance(value, Scan):
            with self._heard:
                if self._cloud[0] is None:
                    self._cloud = time.monotonic(), self._base + when
            self._measure(names.clouds, self._make.cloud(when, LIDAR, value.points, value.ages))
        elif isinstance(value, Inertial):
            x, y, z = (value.yaw_rate * attitude(value.roll, value.pitch, 0.0)[2]).tolist()
            imu = self._make.imu(when, (value.roll, value.pitch, 0.0), (x, y, z))
            self._measure(names.imu, imu)
        elif isinstance(value, Belts):
            speed = value.speed / self.devices.belts.scale
            self._measure(names.belts, self._make.number(float(speed)))

    def _measure(self, topic: str, message: Any) -> None:
        """Send a message of a device, as late as the link is."""
        link = self._link
        if link.loss and self._rng.random() < link.loss:
            return
        late = link.delay + (self._rng.uniform(0.0, link.jitter) if link.jitter else 0.0)
        self._order += 1
        heapq.heappush(self._late, (self._when + late, self._order, topic, message))
        self._flush()

    def _flush(self) -> None:
        while self._late and self._late[0][0] <= self._when:
            *_, topic, message = heapq.heappop(self._late)
            self._send(topic, message)
            self._count += 1

    def _send(self, topic: str, message: Any) -> None:
        if (publish := self._publish[topic]) is not None:
            publish(message)
            self.numbers.sent[topic] += 1

    def _pace(self, when: float) -> None:
        """Wait until a time of the episode is due, and set the clock to it."""
        link = self._link
        if self._base + when != self._now:
            self._tick()  # of the sample before
        if self._zero is None:
            self._zero = time.monotonic() - when / link.rate
            if not link.simulated_clock:
                self._base = time.time() - when
            self._make = replace(self._make, origin=self._base)
        if link.clock_step is not None and self._when <= link.clock_step[0] < when:
            self._base += link.clock_step[1]
            self._make, self._cloud = replace(self._make, origin=self._base), (None, 0.0)
        if not link.lockstep:
            left = self._zero + when / link.rate - time.monotonic()
            if left > 0:
                time.sleep(left)
            elif link.simulated_clock:
                self._zero -= left  # what is late stays late: the robot does not hurry
                self.numbers.behind -= left
            else:
                self.numbers.behind = max(self.numbers.behind, -left)
        self._when, self._now = when, self._base + when

    def _tick(self) -> None:
        """In lockstep, tell the node that a sample is complete, and wait for its answer."""
        now = self._now
        if not self._link.lockstep or self._zero is None or now == self._ticked:
            return
        self._ticked = now
        self._send("simulation/tick", self._make.numbers(np.array([now, self._count])))
        until = time.monotonic() + _ANSWER
        with self._heard:
            while self._answered < now - 1e-6:
                if not self._heard.wait(max(0.0, until - time.monotonic())):
                    raise FlipperctlError(f"lockstep: no command was stamped {now:.2f} s")


def simulate(
    config: EvalConfig,
    devices: Devices,
    link: Link,
    episodes: int,
    tell: Callable[[str], object] = lambda text: None,
) -> Iterator[dict[str, Any]]:
    """Yield the outcome of each episode that a node drives over topics; ``tell``: a remark."""
    if config.perception.lidar is None or getattr(config.perception, "pose", "true") == "true":
        raise RequestError(
            "a simulated robot has a LiDAR, and measures no pose: perception=lidar with "
            "perception.pose=belts or matched is allowed"
        )
    wire = open_wire("simulated_robot")
    try:
        robot, env = TopicRobot(wire, devices, config, link, tell), FlipperEnv(config=config)
        seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
        # The first decision compiles code, for seconds that a robot in real time does not have.
        next(decisions(env, robot, seeds(0)))
        for episode in range(episodes):
            robot.prepare(episode)
            if not robot.answered:
                tell(
                    "no node has answered on simulation/ready; one that does not know it may drive"
                )
            begun, targets, ending = time.monotonic(), [], None
            for decision in decisions(env, robot, seeds(episode), observers=(robot,)):
                targets.append([round(float(angle), 6) for angle in env.drive.targets])
                ending = decision.ending
            assert ending is not None  # decisions() yields until there is one
            if not link.simulated_clock and robot.numbers.behind > _BEHIND:
                tell(
                    f"the simulation was up to {robot.numbers.behind:.1f} s behind real time, and "
                    "its messages as old; with --sim-time the node's clock waits for it"
                )
            yield _row(episode, ending, robot.numbers, env.state, time.monotonic() - begun, targets)
    finally:
        wire.close()


def _row(
    episode: int,
    ending: Mapping[str, Any],
    numbers: Numbers,
    state: RobotState,
    wall: float,
    targets: list[list[float]],
) -> dict[str, Any]:
    answers = np.array(numbers.answers or [math.nan])
    median, most = np.percentile(answers, [50, 99]).tolist()
    return {
        "episode": episode,
        "outcome": str(ending["outcome"]),
        "pitch_variation": ending["pitch_variation_decisions"],
        "pitch_variation_100hz": ending["pitch_variation_100hz"],
        "seconds": state.time,
        "wall": round(wall, 2),
        "behind": round(numbers.behind, 4),
        "commands": numbers.commands,
        "latency_median": median,
        "latency_99": most,
        "processor_share": numbers.processor_share,
        "diagnoses": dict(numbers.diagnoses),
        "targets": targets,
    }
