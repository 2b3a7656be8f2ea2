"""Drift, errors of the map and speed of the estimator of ``perception=lidar``, by kind of ground.

    python -m benchmarks.odometry [--families flat,step] [--episodes N] [--pose belts,matched]

It records drives of ``generalist`` in ``sim=mujoco``, gives the same messages to an estimator of
each kind, and prints for each family and for all drives: the error of the motion along the start's
heading as a fraction of the way and upwards, the median error of the heights under the robot and of
all bins that were seen, how often errors stay within two of the stated standard deviations (95 % if
they are right), and the time that a scan with its estimate takes. The robot perceives with
``perception.pose=true``, so that the drives do not depend on the estimators that are compared.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from flipperctl.api import (
    Estimator,
    FloatArray,
    Instrument,
    Measured,
    Mounting,
    Perception,
    Robot,
    RobotGeometry,
    Transition,
)
from flipperctl.checkpoint import read_policy, shipped_policies
from flipperctl.core.lidar.messages import Belts, Inertial, Scan
from flipperctl.core.observation import bin_heights
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.policies.source import PolicySource
from flipperctl.process import entry
from flipperctl.rollout.episode import decisions
from flipperctl.sim.lidar import LidarSensor

POSES = ("belts", "matched")


FAMILIES: Mapping[str, dict[str, Any]] = {
    "flat": {"length": 10.0},
    "step": {"platform": 7.0},
    "stair": {},
    "building_stair": {"steps": 10},
    "ramp": {"platform": 4.0},
    "uplift": {},
    "gap": {},
    "wave": {"waves": 8},
    "rubble": {"blocks": 20},
    "pallet": {"hurdles": 6},
    "plum": {"piles": 8},
}
"""Kinds of ground, with settings that make short ones longer."""
_UNDER = 0.38
"""Bins this near to the chassis centre lie under the robot [m]."""
_SPACING = 0.02
"""Distance between the points of the true ground [m]."""
_ROOM = 30.0
"""Length of the true ground before and after the terrain [m]."""


class Decided(NamedTuple):
    """The truth when a policy decided."""

    time: float
    """Time since the start [s]."""
    received: int
    """Number of messages until then [-]."""
    pose: FloatArray
    """(4,) x, y, z [m] and heading [rad] of the chassis centre."""
    heights: FloatArray
    """(N,) heights of the true ground in frame L [m]."""


class _Recording(LidarSensor):
    """Measures for odometry, and perceives by the true pose."""

    def instruments(self, mounting: Mounting) -> Mapping[str, Instrument]:
        """Return those of both kinds of poses."""
        fields = {name: getattr(self, name) for name in LidarSensor.model_fields}
        measured = LidarSensor(**{**fields, "pose": "belts"}).instruments(mounting)
        tracked = LidarSensor(**fields).instruments(mounting)
        return {**{k: v for k, v in tracked.items() if k.startswith("tracking")}, **measured}

    def estimator(self, robot: RobotGeometry) -> Estimator:
        """Return an estimator that ignores odometry."""
        found = super().estimator(robot)
        receive = found.update

        def update(measured: Measured) -> None:
            if not isinstance(measured.value, Belts | Inertial):
                receive(measured)

        found.update = update  # type: ignore[method-assign]  # of this estimator alone
        return found


class Recorder(Observer):
    """One drive."""

    def __init__(self) -> None:
        self.messages: list[Measured] = []
        """What belts, inertial unit, encoders and LiDAR measured, in the order of arrival."""
        self.decisions: list[Decided] = []

    def measured(self, measured: Measured) -> None:
        """Keep a measurement of a robot's own devices."""
        if not measured.instrument.startswith("tracking"):
            self.messages.append(measured)

    def decided(self, t: Transition, p: Perception, rewards: Mapping[str, float]) -> None:
        """Keep the truth at a decision."""
        s = t.before
        after = [m.time > s.time + 1e-6 for m in self.messages]
        received = after.index(True) if True in after else len(after)
        pose = np.array([s.position[0], s.side, s.position[1], s.yaw])
        cloud = t.profile.sample(_SPACING, p.layout.reach + _ROOM) - s.position
        inside = (cloud[:, 0] >= -p.layout.reach) & (cloud[:, 0] < p.layout.reach)
        heights = bin_heights(cloud[inside], p.layout.bins, p.layout.bin_width, highest=False)
        self.decisions.append(Decided(s.time, received, pose, heights))


def record(family: str, seed: int, sensor: Mapping[str, Any], sim: Mapping[str, Any]) -> Recorder:
    """Drive over one ground of a family; ``sensor`` are settings of ``perception=lidar``."""
    terrain = {"name": family, **FAMILIES[family]}
    file = shipped_policies()["generalist"]
    layout = read_policy(file).policy_config().perception.layout.model_dump()
    sensing = _Recording(**layout, **sensor)
    env = FlipperEnv(terrain, sim={"name": "mujoco", **sim}, perception=sensing)
    driver = PolicySource(checkpoint=file).build(env.config)
    recorder = Recorder()
    for _ in decisions(env, driver, seed, observers=[recorder]):
        pass
    return recorder


class Errors(NamedTuple):
    """Errors of one estimator in one drive."""

    way: float
    """Distance driven [m]."""
    along: float
    """Error of the motion along the heading of the start, at the end [m]."""
    up: float
    """Error of the motion upwards, at the end [m]."""
    below: FloatArray
    """Errors of the heights of bins under the robot that were seen, at all decisions [m]."""
    heights: FloatArray
    """Errors of the heights of all bins that were seen [m]."""
    relative: FloatArray
    """The same, in stated standard deviations [-]."""
    seconds: FloatArray
    """CPU time of each scan, with the estimate after it [s]."""


def errors(drive: Recorder, sensor: LidarSensor) -> Errors:
    """Give the messages of a drive to a new estimator and compare its estimates with the truth."""
    estimator, received = sensor.estimator(Robot()), 0
    middle = (np.arange(sensor.bins) - (sensor.bins - 1) / 2) * sensor.bin_width
    under = np.abs(middle) < _UNDER
    below, heights, relative, places = (list[FloatArray]() for _ in range(4))
    seconds: list[float] = []
    for truth in drive.decisions:
        for message in drive.messages[received : truth.received]:
            begun = time.process_time()
            estimator.update(message)
            if isinstance(message.value, Scan):
                seconds.append(time.process_time() - begun)
        received = truth.received
        begun = time.process_time()
        ground, _ = estimator.estimate(truth.time)
        if seconds:
            seconds[-1] += time.process_time() - begun
        place, seen, deviation = ground.position, ground.seen, ground.deviation
        assert place is not None
        assert seen is not None
        assert deviation is not None
        assert ground.heights is not None
        off = ground.heights[: sensor.bins] - truth.heights
        places.append(place)
        below.append(off[seen & under])
        heights.append(off[seen])
        relative.append(off[seen] / deviation[seen])
    first, last = drive.decisions[0].pose, drive.decisions[-1].pose
    moved = last - first
    along = math.cos(first[3]) * moved[0] + math.sin(first[3]) * moved[1]
    estimated = places[-1] - places[0]
    return Errors(
        way=float(moved[0]),
        along=float(estimated[0] - along),
        up=float(estimated[1] - moved[2]),
        below=np.concatenate(below),
        heights=np.concatenate(heights),
        relative=np.concatenate(relative),
        seconds=np.array(seconds),
    )


def line(name: str, found: Sequence[Errors]) -> str:
    """Return a row of the table."""
    along = 100 * np.array([abs(e.along) / e.way for e in found])
    up = 100 * np.array([abs(e.up) for e in found])
    below = 100 * np.abs(np.concatenate([e.below for e in found]))
    heights = 100 * np.abs(np.concatenate([e.heights for e in found]))
    relative = np.abs(np.concatenate([e.relative for e in found]))
    seconds = 1e3 * np.concatenate([e.seconds for e in found])
    return (
        f"{name:24s} {np.mean([e.way for e in found]):5.1f}"
        f" {np.median(along):6.2f} {np.quantile(along, 0.95):6.2f}"
        f" {np.median(up):6.2f} {np.quantile(up, 0.95):6.2f}"
        f" {np.median(below):6.2f} {np.median(heights):6.2f} {np.quantile(heights, 0.95):6.2f}"
        f" {100 * np.mean(relative <= 1):5.1f} {100 * np.mean(relative <= 2):5.1f}"
        f" {np.median(seconds):6.1f} {np.quantile(seconds, 0.99):6.1f}"
    )


HEADER = (
    f"{'':24s} {'way':>5s} {'x':>6s} {'x p95':>6s} {'z':>6s} {'z p95':>6s}"
    f" {'below':>6s} {'map':>6s} {'p95':>6s} {'1 σ':>5s} {'2 σ':>5s} {'scan':>6s} {'p99':>6s}\n"
    f"{'':24s} {'m':>5s} {'%':>6s} {'%':>6s} {'cm':>6s} {'cm':>6s}"
    f" {'cm':>6s} {'cm':>6s} {'cm':>6s} {'%':>5s} {'%':>5s} {'ms':>6s} {'ms':>6s}"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; exit with code 2 if an argument is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.odometry")
    parser.add_argument("--families", default=",".join(FAMILIES), help="kinds of ground [all]")
    parser.add_argument("--episodes", type=int, default=1, help="drives on each kind [1]")
    parser.add_argument("--seed", type=int, default=910_000, help="of the first drive [910000]")
    parser.add_argument("--pose", default=",".join(POSES), help="belts, matched or both [both]")
    parser.add_argument("--azimuths", type=int, default=225, help="rays of each ring [225]")
    parser.add_argument("--noise", type=float, default=0.01, help="of a distance, in m [0.01]")
    parser.add_argument("--yaw", type=float, default=0.0, help="largest heading, in degrees [0]")
    chosen = parser.parse_args(arguments)
    families, poses = chosen.families.split(","), chosen.pose.split(",")
    for name, given, allowed in (("families", families, FAMILIES), ("pose", poses, POSES)):
        if unknown := [one for one in given if one not in allowed]:
            parser.error(f"--{name}: {unknown[0]}; allowed: {', '.join(allowed)}")
    if chosen.episodes < 1:
        parser.error(f"--episodes: {chosen.episodes}; 1 or more is allowed")
    sensor = {"azimuths": chosen.azimuths, "noise": chosen.noise}
    sim = {"yaw": math.radians(chosen.yaw)} if chosen.yaw else {}
    print(HEADER)
    total: dict[str, list[Errors]] = {pose: [] for pose in poses}
    for family in families:
        found: dict[str, list[Errors]] = {pose: [] for pose in poses}
        for seed in range(chosen.seed, chosen.seed + chosen.episodes):
            drive = record(family, seed, sensor, sim)
            for pose in poses:
                found[pose].append(errors(drive, LidarSensor(pose=pose, **sensor)))
        for pose in poses:
            print(line(f"{family} {pose}", found[pose]), flush=True)
            total[pose] += found[pose]
    for pose in poses:
        print(line(f"all {pose}", total[pose]))
    return 0


if __name__ == "__main__":
    entry.run(main)
