"""Drift, errors of the map and speed of the estimator of ``perception=lidar``, by kind of ground.

    python -m benchmarks.odometry [--families flat,step] [--episodes N] [--pose belts,matched]

It records drives in ``sim=mujoco`` (``benchmarks.drives``), gives the same messages to an estimator
of each kind, and prints for each family and for all drives: the error of the motion along the
start's heading as a fraction of the way and upwards, the median error of the heights under the
robot and of all bins that were seen, how often errors stay within two of the stated standard
deviations (95 % if they are right), and the time that a scan with its estimate takes.
"""

from __future__ import annotations

import argparse
import math
import pickle
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.drives import FAMILIES, Recorded, occupied, record
from flipperctl import entry
from flipperctl.api import FloatArray, Robot
from flipperctl.core.lidar.messages import Scan
from flipperctl.sim.lidar import LidarSensor

POSES = ("belts", "matched")


@dataclass(frozen=True)
class Errors:
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


def errors(drive: Recorded, sensor: LidarSensor) -> Errors:
    """Give the messages of a drive to a new estimator and compare its estimates with the truth."""
    estimator = sensor.estimator(Robot())
    below: list[FloatArray] = []
    seen_errors: list[FloatArray] = []
    relative: list[FloatArray] = []
    seconds: list[float] = []
    places: list[FloatArray] = []
    received = 0
    for truth in drive.decided:
        scan = 0.0
        for message in drive.messages[received : truth.received]:
            begun = time.process_time()
            estimator.update(message)
            if isinstance(message.value, Scan):
                scan = time.process_time() - begun
                seconds.append(scan)
        received = truth.received
        begun = time.process_time()
        ground, _ = estimator.estimate(truth.time)
        if seconds:
            seconds[-1] += time.process_time() - begun
        assert ground.position is not None
        assert ground.seen is not None
        assert ground.deviation is not None
        places.append(ground.position)
        off, seen = ground.heights - truth.heights, ground.seen
        below.append(off[seen & occupied(off)])
        seen_errors.append(off[seen])
        relative.append(off[seen] / ground.deviation[seen])
    first, last = drive.decided[0].pose, drive.decided[-1].pose
    moved = last - first
    along = math.cos(first[3]) * moved[0] + math.sin(first[3]) * moved[1]
    estimated = places[-1] - places[0]
    return Errors(
        way=drive.way,
        along=float(estimated[0] - along),
        up=float(estimated[1] - moved[2]),
        below=np.concatenate(below),
        heights=np.concatenate(seen_errors),
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


def recorded(folder: Path | None, family: str, seed: int, **how: Any) -> Recorded:
    """Return a drive, from ``folder`` if it was kept there under these settings."""
    if folder is None:
        return record(family, seed, **how)
    words = [f"{k}{v}" for part in how.values() for k, v in part.items()]
    path = folder / ("-".join([family, str(seed), *words]) + ".pickle")
    if path.is_file():
        return cast("Recorded", pickle.loads(path.read_bytes()))  # noqa: S301  # written below
    made = record(family, seed, **how)
    folder.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(made))
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table; exit with code 2 if an argument is wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.odometry",
        description="Measure drift, errors of the map and speed of perception=lidar.",
    )
    parser.add_argument("--families", default=",".join(FAMILIES), help="kinds of ground [all]")
    parser.add_argument("--episodes", type=int, default=1, help="drives on each kind [1]")
    parser.add_argument("--seed", type=int, default=910_000, help="of the first drive [910000]")
    parser.add_argument("--pose", default=",".join(POSES), help="belts, matched or both [both]")
    parser.add_argument("--azimuths", type=int, default=225, help="rays of each ring [225]")
    parser.add_argument("--noise", type=float, default=0.01, help="of a distance, in m [0.01]")
    parser.add_argument("--yaw", type=float, default=0.0, help="largest heading, in degrees [0]")
    parser.add_argument(
        "--keep", type=Path, help="folder in which drives are kept and found again [none]"
    )
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
            drive = recorded(chosen.keep, family, seed, sensor=sensor, sim=sim)
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
