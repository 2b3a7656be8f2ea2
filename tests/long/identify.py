"""Simulated robots with unknown values: do the intervals of ``robot identify`` hold them?

``python -m tests.long.identify --count 50 --seed 1``: each robot has its own masses, which a
builder weighs, and speeds, delay, torque and friction, which the bag has to tell. It drives as
docs/robot.md prescribes, and its devices are noisy. The table has how many intervals hold the
truth, how many have two ends, and how wide those are.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flipperctl.api import ACTIONS, Command, Perception, Robot, RobotState, World, action_index
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.ros.episode import Stamped, write_bag
from flipperctl.ros.identify import identify
from flipperctl.ros.messages import Messages
from flipperctl.runtime.devices import Devices

UNKNOWN = {
    "robot.flipper_speed": (0.3, 0.7),
    "robot.actuator_delay": (0.0, 0.2),
    "robot.track_speed": (0.15, 0.4),
    "robot.flipper_torque": (20.0, 120.0),
    "sim.friction": (0.4, 1.1),
}
KNOWN = {"robot.chassis_mass": (30.0, 40.0), "robot.flipper_mass": (4.0, 6.0)}
SLOPES = 28.0, 38.0, 50.0
"""Inclinations that it is let slide from [°]."""
CLIMB, PLATFORM, BOARD = math.radians(18), 0.8, 1.8
"""Inclination of the ways up [rad]; length of the platforms, and of the halves that are half as
steep, and of the slopes [m]."""
UP, RAISED, BELOW = 1.0, 0.8, -1.0
PERIOD, RATE = 0.01, 50


class Ground(NamedTuple):
    """The ground of the drive."""

    points: list[tuple[float, float]]
    boards: list[tuple[float, float]]
    """Where each slope begins, and its inclination [rad]."""

    @classmethod
    def of(cls, slopes: tuple[float, ...]) -> Ground:
        points, boards = [(0.0, 0.0)], []
        for slope in map(math.radians, slopes):
            ways = [(PLATFORM, 0.0), (PLATFORM, -slope / 2), (BOARD, -slope), (1.0, 0.0)]
            high = -sum(way * math.sin(angle) for way, angle in ways)
            for way, angle in ((high / math.sin(CLIMB), CLIMB), *ways):
                if angle == -slope:
                    boards.append((points[-1][0], slope))
                x, z = points[-1]
                points.append((x + way * math.cos(angle), z + way * math.sin(angle)))
        return cls(points, boards)


class Builder(Observer):
    """Drives as a builder does, and notes what the devices measure."""

    every = 1
    command_period = PERIOD
    risk_sign = None

    def __init__(self, ground: Ground, rule: Any) -> None:
        self.ground, self.rule, self.done = ground, rule, False
        self.states: list[RobotState] = []
        self.commands: list[tuple[float, Command]] = []
        self._targets, self._last = (0.0, 0.0), Command(0.0, 0.0, 0.0)

    def reset(self, simulator: Any) -> None:
        self.rule.reset(simulator)

    def act(self, p: Perception) -> int:
        """Ask the rule, which turns the flippers on the way up; commands count."""
        turns = np.array(ACTIONS[self.rule.act(p)]) * p.robot.angle_step
        limit = p.robot.angle_limit
        self._targets = tuple(np.clip(np.array(self._targets) + turns, -limit, limit).tolist())
        return action_index(0, 0)

    def command(self, world: World) -> Command:
        if not self.commands:
            self._script = self._drive(world)
        last = next(self._script, None)
        self.done, self._last = last is None, last or self._last
        self.commands.append((world.state().time, self._last))
        return self._last

    def stopped(self, world: World) -> None:
        self.states.append(world.state())

    def _drive(self, world: World) -> Iterator[Command]:
        # Turns without a load, then one pair against the ground while the other is raised
        turns = (0, 0), (UP, 0), (0, 0), (0, UP), (0, 0), (UP, UP), (0.2, 0.2), (UP, UP)
        presses = (BELOW, UP), (UP, BELOW), (BELOW, 0.26), (BELOW, 0.38), (BELOW, BELOW)
        for front, rear in turns:
            yield from self._turned(world, front, rear)
        for front, rear in presses:
            yield from self._turned(world, UP, UP)
            yield from self._turned(world, UP if front < 0 else front, rear if front < 0 else UP)
            yield from self._turned(world, front, rear)
        # Ahead by the rule, over level ground and up; down each slope until it slides
        yield from self._turned(world, 0.0, 0.0)
        self._targets = 0.0, 0.0
        for edge, slope in self.ground.boards:
            top = edge - PLATFORM * (1 + math.cos(slope / 2))
            while (x := world.position[0]) < edge + 0.5 * math.cos(slope):
                yield Command(*(self._targets if x < top else (RAISED, RAISED)), 1.0)
                if x < top + 0.1 <= world.position[0]:
                    yield from self._turned(world, RAISED, RAISED)
            before = world.position[0]
            for _ in range(round(2.0 / PERIOD)):
                yield Command(RAISED, RAISED, 0.0)
            if world.position[0] - before > 0.2:
                return
            self._targets = RAISED, RAISED

    def _turned(self, world: World, front: float, rear: float) -> Iterator[Command]:
        """Turn both pairs, and wait until they stand for a while, but no longer than 10 s."""
        still, begin = 0.0, world.state().time
        while still < 1.5 and world.state().time < begin + 10:
            before = world.state()
            yield Command(front, rear, 0.0)
            after = world.state()
            moved = max(abs(after.front - before.front), abs(after.rear - before.rear))
            still = still + PERIOD if moved < 0.05 * PERIOD else 0.0


def recorded(
    rng: np.random.Generator, slopes: tuple[float, ...], folder: Path
) -> tuple[dict[str, float], Robot]:
    """Write the bag of a robot; return the truth, and the robot as its builder knows it."""
    ground = Ground.of(slopes)
    csv = folder / "ground.csv"
    csv.write_text("x,z\n" + "".join(f"{x},{z}\n" for x, z in ground.points))
    randomise: dict[str, dict[str, Any]] = {"robot": {}, "sim": {}}
    for key, ends in (UNKNOWN | KNOWN).items():
        section, _, name = key.partition(".")
        randomise[section][name] = ends
    env = FlipperEnv(
        {"name": "profile_file", "path": str(csv)},
        randomise=randomise,
        episode={"run_up": 2.5, "slack": 100, "stuck_time": 60, "start_noise": 0, "overturn": 1.5},
    )
    rule = PolicySource(settings={"name": "okada"}).build(env.config)
    builder = Builder(ground, rule)
    for _ in decisions(env, builder, int(rng.integers(2**31)), observers=(builder,)):
        if builder.done:
            break
    truth = {
        key: float(getattr(env.robot if key.startswith("robot") else env.engine, key.split(".")[1]))
        for key in UNKNOWN
    }
    write_bag(folder / "bag", list(_messages(builder, truth["robot.track_speed"], rng)))
    known = {key.split(".")[1]: getattr(env.robot, key.split(".")[1]) for key in KNOWN}
    return truth, Robot(**known)


def _messages(builder: Builder, speed: float, rng: np.random.Generator) -> Iterator[Stamped]:
    make, last = Messages(), None
    for time, command in builder.commands:
        if command[:2] != last or round(time / PERIOD) % 10 == 0:
            last = command[:2]
            yield Stamped(time, "/flipper_controller/commands", make.numbers(make.angles(last)))
    for state in builder.states[:: round(1 / (PERIOD * RATE))]:
        time, noise = state.time, rng.normal(0, 0.003, 3)
        joints = state.front + noise[0], state.rear + noise[1]
        yield Stamped(time, "/joint_states", make.joint_state(time, *joints))
        attitude = 0.0, state.pitch + noise[2], 0.0
        yield Stamped(time, "/imu/data", make.imu(time, attitude, (0.0, -state.pitch_rate, 0.0)))
        belts = speed if state.belts is None else float(state.belts.mean())
        yield Stamped(time, "/belt_speed", make.number(belts + rng.normal(0, 0.003)))
        place = state.position + rng.normal(0, 0.002, 2)
        noisy = RobotState(place, state.pitch, *joints, state.velocity, state.pitch_rate, time)
        yield Stamped(time, "/odom", make.odometry(noisy))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    rows: dict[str, list[tuple[bool, bool, float]]] = {key: [] for key in UNKNOWN}
    for rng in np.random.default_rng(arguments.seed).spawn(arguments.count):
        with tempfile.TemporaryDirectory() as folder:
            truth, known = recorded(rng, SLOPES, Path(folder))
            told = identify(Path(folder) / "bag", known, Devices())["values"]
        for key, value in truth.items():
            low, high = told[key]["low"], told[key]["high"]
            top = math.inf if high is None else high
            rows[key].append((low <= value <= top, low > 0 and top < math.inf, top - low))
            if arguments.verbose:
                print(f"{key:22} {value:.4f} in [{low:.4f}, {top:.4f}] {told[key]['why']}")
    print(f"{'value':22} {'holds':>6} {'two ends':>9} {'their width (median)':>21}")
    for key, drawn in rows.items():
        widths = [width for _, both, width in drawn if both]
        width = f"{np.median(widths):.3g}" if widths else "-"
        holds, both = (sum(row[i] for row in drawn) for i in (0, 1))
        print(f"{key:22} {holds:>3}/{len(drawn)} {both:>9} {width:>21}")
    return int(any(sum(row[0] for row in drawn) < 0.9 * len(drawn) for drawn in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
