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
from dataclasses import replace
from pathlib import Path

import numpy as np

from flipperctl.ros.recording import Step, read_recording, setup_of
from flipperctl.ros.topics import Names
from flipperctl.runtime import Cloud, FlipperController, RobotSetup
from flipperctl.sim.lidar import LidarSensor

_TURN = 0.1
"""Time of a turn of the LiDAR [s]."""
_WARM_UP = 20
"""Steps at the beginning that do not count; the first ones load what Python needs [-]."""


Durations = dict[str, list[tuple[float, float]]]
"""Kind of a step → its computing time and its time on the clock, for each step [ms]."""


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
        points = np.asarray(cloud.points, np.float64)
        ages = np.zeros(len(points)) if cloud.ages is None else np.asarray(cloud.ages, np.float64)
        order = np.argsort(-ages, kind="stable")
        for index, chosen in enumerate(np.array_split(order, parts)):
            newest = _TURN * (parts - 1 - index) / parts  # a controller skips equal stamps
            own = np.maximum(ages[chosen] - newest, 0.0)
            part = replace(cloud, time=cloud.time - newest, points=points[chosen], ages=own)
            found.append(Step(step.now - newest, {"cloud": part}))
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


def measure(policy: Path, steps: list[Step], setup: RobotSetup) -> Durations:
    """Return the durations of steps with a scan, of those that decide, and of all others."""
    controller = FlipperController(policy, setup, shadow=True)
    found: Durations = {"all": [], "with a scan": [], "that decide": [], "without a scan": []}
    for index, step in enumerate(steps):
        began = time.thread_time(), time.perf_counter()
        answer = controller.step(step.now, **step.messages)  # type: ignore[arg-type]  # by device
        ended = time.thread_time(), time.perf_counter()
        spent = 1000 * (ended[0] - began[0]), 1000 * (ended[1] - began[1])
        kinds = ["all", "with a scan" if "cloud" in step.messages else "without a scan"]
        kinds += ["that decide"] if answer.action is not None else []
        for kind in kinds if index >= _WARM_UP else ():
            found[kind].append(spent)
    return found


def main(policy: Path, bag: Path, parts: int, dense: int, repeats: int) -> int:
    """Print a table of the durations."""
    recording = read_recording(bag, Names())
    setup = setup_of(recording, LidarSensor().lidar, "belts")
    whole = denser(list(recording.steps()), dense)
    clouds = [step.messages.get("cloud") for step in whole]
    points = [len(np.asarray(c.points)) for c in clouds if isinstance(c, Cloud)]
    print(f"{bag}: {len(points)} turns of {np.mean(points):.0f} points")
    print(f"{'step':32}{'count':>7}{'p50':>9}{'p99':>9}{'p50':>9}{'p99':>9}")
    print(f"{'':39}{'computing [ms]':>18}{'clock [ms]':>18}")
    for name, steps in (("turn", whole), (f"1/{parts} turn", sectors(whole, parts))):
        found = [measure(policy, steps, setup) for _ in range(repeats)]
        for kind in found[0]:
            if spent := [d for one in found for d in one[kind]]:  # (D, 2) [ms]
                quantiles = np.percentile(spent, (50, 99), axis=0).T.ravel()
                told = "".join(f"{q:9.2f}" for q in quantiles)
                print(f"{f'{name}, {kind}':32}{len(spent):7}{told}")
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
