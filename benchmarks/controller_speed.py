"""How long a step of the robot's controller takes: ``python -m benchmarks.controller_speed``.

In: an exported policy, and a bag of its robot, such as ``flipperctl export mcap`` with
``perception=lidar perception.pose=belts`` writes. Out: quantiles of the duration of a step, with a
scan of a whole turn, and with each turn in sectors, as a driver of packets delivers it.
Both the computing time and the time on the clock are told; others' load counts in the latter alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.ros.devices import Step, read_recording
from flipperctl.ros.shadowing import setup_of
from flipperctl.ros.topics import Names
from flipperctl.runtime import Cloud, FlipperController, RobotSetup
from flipperctl.sim.lidar import LidarSensor

_TURN = 0.1
"""Time of a turn of the LiDAR [s]."""
_WARM_UP = 20
"""Steps at the beginning that do not count; the first ones load what Python needs [-]."""


@dataclass
class _Durations:
    """Durations of steps [ms]."""

    computing: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)

    def add(self, computing: float, clock: float) -> None:
        self.computing.append(1000 * computing)
        self.clock.append(1000 * clock)

    def line(self, name: str) -> str:
        quantiles = [np.percentile(part, (50, 99)) for part in (self.computing, self.clock)]
        (c50, c99), (t50, t99) = quantiles
        count = len(self.computing)
        return f"{name:32}{count:7}{c50:9.2f}{c99:9.2f}{t50:9.2f}{t99:9.2f}"


def sectors(steps: list[Step], parts: int) -> list[Step]:
    """Return the steps with each cloud in ``parts``, oldest points first, each at its own time."""
    found: list[Step] = []
    for step in steps:
        cloud = step.messages.get("cloud")
        if not isinstance(cloud, Cloud):
            found.append(step)
            continue
        others = {name: told for name, told in step.messages.items() if name != "cloud"}
        if others:
            found.append(Step(step.now, others))
        found += _parts(step, cloud, parts)
    return sorted(found, key=lambda step: step.now)


def denser(steps: list[Step], times: int) -> list[Step]:
    """Return the steps with ``times`` as many points in each cloud, 1 cm around those there."""
    rng, found = np.random.default_rng(0), []
    for step in steps:
        cloud = step.messages.get("cloud")
        if times > 1 and isinstance(cloud, Cloud):
            points = np.repeat(np.asarray(cloud.points, np.float64), times, axis=0)
            points += 0.01 * rng.standard_normal(points.shape)
            ages = None if cloud.ages is None else np.repeat(np.asarray(cloud.ages), times)
            messages = {**step.messages, "cloud": replace(cloud, points=points, ages=ages)}
            step = Step(step.now, messages)
        found.append(step)
    return found


def _parts(step: Step, cloud: Cloud, parts: int) -> Iterator[Step]:
    points = np.asarray(cloud.points, np.float64)
    ages = np.zeros(len(points)) if cloud.ages is None else np.asarray(cloud.ages, np.float64)
    order = np.argsort(-ages, kind="stable")
    for index, chosen in enumerate(np.array_split(order, parts)):
        newest = _TURN * (parts - 1 - index) / parts  # a controller skips equal stamps
        own: NDArray[np.float64] = np.maximum(ages[chosen] - newest, 0.0)
        part = replace(cloud, time=cloud.time - newest, points=points[chosen], ages=own)
        yield Step(step.now - newest, {"cloud": part})


def measure(policy: Path, steps: list[Step], setup: RobotSetup) -> dict[str, _Durations]:
    """Return the durations of steps with a scan, of those that decide, and of all others."""
    controller = FlipperController(policy, setup, shadow=True)
    found = {name: _Durations() for name in ("all", "with a scan", "that decide", "without a scan")}
    for index, step in enumerate(steps):
        began = time.perf_counter(), time.thread_time()
        answer = controller.step(step.now, **step.messages)  # type: ignore[arg-type]  # by device
        spent = time.thread_time() - began[1], time.perf_counter() - began[0]
        if index < _WARM_UP:
            continue
        found["all"].add(*spent)
        found["with a scan" if "cloud" in step.messages else "without a scan"].add(*spent)
        if answer.action is not None:
            found["that decide"].add(*spent)
    return found


def main(policy: Path, bag: Path, parts: int, dense: int, repeats: int) -> int:
    """Print a table of the durations."""
    recording = read_recording(bag, Names())
    setup = setup_of(recording, LidarSensor(), "belts")
    whole = denser(list(recording.steps()), dense)
    clouds = [step.messages.get("cloud") for step in whole]
    points = [len(np.asarray(c.points)) for c in clouds if isinstance(c, Cloud)]
    print(f"{bag}: {len(points)} turns of {np.mean(points):.0f} points")
    print(f"{'step':32}{'count':>7}{'p50':>9}{'p99':>9}{'p50':>9}{'p99':>9}")
    print(f"{'':39}{'computing [ms]':>18}{'clock [ms]':>18}")
    for name, steps in (("turn", whole), (f"1/{parts} turn", sectors(whole, parts))):
        found = [measure(policy, steps, setup) for _ in range(repeats)]
        for kind in found[0]:
            both = _Durations(
                [d for one in found for d in one[kind].computing],
                [d for one in found for d in one[kind].clock],
            )
            if both.computing:
                print(both.line(f"{name}, {kind}"))
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.controller_speed")
    parser.add_argument("policy", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--sectors", type=int, default=8)
    parser.add_argument("--dense", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=1)
    given = parser.parse_args()
    sys.exit(main(given.policy, given.bag, given.sectors, given.dense, given.repeats))
