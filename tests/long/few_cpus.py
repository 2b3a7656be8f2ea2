"""Trainings on a Ray cluster with fewer free CPUs than workers, some of them stopped by a signal.

``python -m tests.long.few_cpus --count 20 --seed 1`` starts a cluster for each case, with 0, 1 or 2
CPUs free, trains on it and prints the cases. With a CPU free a run finishes and says how many
workers have got none; without one it fails with one error; stopped, it is resumed to its end.

The cluster has a process of its own, ``--cluster CPUS TAKEN``, which alone connects to Ray, whose
threads no fork may inherit. It prints the address, gives the taken CPUs free at the first line of
its input, and ends with its input.
"""

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.long.forked import LIMIT, QUICK, Command, Tally, preload, start

_ROOT = Path(__file__).parents[2]
_LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""Environment variable that lets Ray use the address 127.0.0.1, as it does on those systems."""
_TO_STOP, _TO_FAIL, _TO_LEAVE = 20.0, 30.0, 20.0
"""Longest times from a signal to the end, from the patience to the error, and that a command's
processes have to end after it [s]."""
_SAID = re.compile(r"(\d+) of (\d+) Ray workers \(collector\.workers\) have no CPU")


def serve(cpus: int, taken: int) -> None:
    """Start a cluster and keep it until the input ends."""
    import ray
    from ray.cluster_utils import Cluster
    from ray.util.placement_group import placement_group, remove_placement_group

    node: dict[str, Any] = {"num_cpus": cpus, "object_store_memory": 80 * 2**20}
    node |= {"include_dashboard": False, "include_log_monitor": False, "no_monitor": True}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    group = placement_group([{"CPU": taken}]) if taken else None
    assert group is None or group.wait(30), "the CPUs could not be taken"
    print(f"address {cluster.address}", flush=True)
    for _ in sys.stdin:
        if group:
            remove_placement_group(group)
        group = None
        print("free", flush=True)
    ray.shutdown()
    cluster.shutdown()


@contextmanager
def ray_cluster(cpus: int, taken: int, folder: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield the address of a cluster and what frees its CPUs; the path must be short (sockets)."""
    folder.mkdir()
    words = [sys.executable, "-m", "tests.long.few_cpus", "--cluster", str(cpus), str(taken)]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    own = {**os.environ, **_LOOPBACK, "RAY_TMPDIR": str(folder)}
    with (folder / "log").open("w") as log:
        done = subprocess.Popen(
            words, cwd=_ROOT, env=own, stderr=log, start_new_session=True, **pipes
        )
    assert done.stdin is not None
    assert done.stdout is not None
    lines = (line for line in done.stdout if line.startswith("address "))
    address = next(lines, "").removeprefix("address ").strip()
    if not address:
        raise SystemExit(f"no Ray cluster has started: {(folder / 'log').read_text()}")

    def free() -> None:
        print("free", file=done.stdin, flush=True)
        done.stdout.readline()  # type: ignore[union-attr]

    try:
        yield address, free
    finally:
        done.stdin.close()
        try:
            done.wait(60)
        except subprocess.TimeoutExpired:
            done.kill()
            done.wait()
        done.stdout.close()


class Case:
    """A training in a folder of its own; what is violated stands in ``faults``."""

    def __init__(self, index: int, folder: Path, rng: random.Random) -> None:
        self.folder, self.run, self.faults = folder, folder / "run", list[str]()
        self.free, self.workers = index % 3, rng.randint(1, 8)
        self.taken = rng.randint(0 if self.free else 1, 2)
        self.stop = rng.choice([signal.SIGINT, signal.SIGTERM, None, None, None])
        self.delay = rng.uniform(0.0, 6.0)
        self.patience = 300 if self.free or self.stop else rng.randint(2, 6)
        self.decisions = 100_000 if self.stop else rng.choice([300, 8000])
        folder.mkdir()

    def __str__(self) -> str:
        """Return the case as a line."""
        stop = self.stop.name if self.stop else "-"
        drawn = f"free {self.free}, taken {self.taken}, workers {self.workers}, stop {stop}"
        return f"{drawn}: {'; '.join(self.faults) or 'as expected'}"

    def play(self) -> None:
        """Run the case."""
        with ray_cluster(self.free + self.taken, self.taken, self.folder / "r") as (address, free):
            settings = dict(word.split("=") for word in QUICK) | {
                "train.decisions": self.decisions,
                "train.validate_every": 1000,
                "train.mode": "fast",
                "collector": "ray",
                "collector.address": address,
                "collector.workers": self.workers,
                "collector.patience": self.patience,
                "hydra.run.dir": "run",
            }
            words = ["train", *(f"{key}={value}" for key, value in settings.items())]
            command = start(words, self.folder, self.folder / "log")
            if self.stop is not None:
                self._stop(command)
                free()
                self._resume()
            else:
                self._end(command, 0 if self.free else 1)
                errors = [line for line in command.text.splitlines() if line.startswith("error: ")]
                if not self.free and (len(errors) != 1 or "got a CPU" not in errors[0]):
                    self.faults.append(f"errors: {errors}")
                if not self.free and command.age > self.patience + _TO_FAIL:
                    self.faults.append("it fails too late")
        if left := self._left(cluster=True):
            self.faults.append(f"left after the cluster: {left}")
        if not self.faults:
            shutil.rmtree(self.folder)

    def _stop(self, command: Command) -> None:
        """Send the signal some seconds after the run has begun."""
        while not command.ended() and command.age < 60 and not (self.run / "config.yaml").exists():
            time.sleep(0.01)
        at = command.age + self.delay
        while not command.ended() and command.age < at:
            time.sleep(0.01)
        assert self.stop is not None
        command.send(self.stop)
        sent = command.age
        self._end(command, 130)
        if command.age - sent > _TO_STOP:
            self.faults.append("it ends too long after the signal")
        if "all is saved" not in command.text:
            self.faults.append("it does not say that all is saved")

    def _resume(self) -> None:
        """Resume the stopped run on the same cluster, all of whose CPUs are free now."""
        from flipperctl.training.listeners import read_rows

        before = read_rows(self.run / "metrics.csv")
        budget = (int(before[-1]["decision"]) if before else 0) + 100
        words = ["train", "--resume", "run", f"train.decisions={budget}"]
        self._end(start(words, self.folder, self.folder / "resumed"), 0, resumed=True)
        after = read_rows(self.run / "metrics.csv")
        if after[: len(before)] != before or len(after) <= len(before):
            self.faults.append("episodes of before are not kept")

    def _end(self, command: Command, code: int, *, resumed: bool = False) -> None:
        """Wait for the end of a command and of its workers; check its code and what it said."""
        tally = Tally()
        tally.hangs += not command.wait(LIMIT)
        tally.check(command, code)
        if tally.violations:
            self.faults.append(f"exit code {command.code}, not {code}: {command.text}")
        if left := self._left():
            self.faults.append(f"left after the command: {left}")
        without, said = max(0, self.workers - self.free), _SAID.findall(command.text)
        if said and not resumed and said != [(str(without), str(self.workers))]:
            self.faults.append(f"{without} workers have no CPU; it says {said}")

    def _left(self, *, cluster: bool = False) -> list[str]:
        """Return the processes that have files here open after a while, those of Ray only asked."""
        logs = {str(self.folder / name) for name in ("log", "resumed")}
        end = time.monotonic() + _TO_LEAVE
        while True:
            found = []
            for entry in Path("/proc").glob("[0-9]*"):
                try:
                    files = {str(link.readlink()) for link in (entry / "fd").iterdir()}
                    words = (entry / "cmdline").read_text().replace("\0", " ").strip()
                except OSError:  # it has ended
                    continue
                inside = any(name.startswith(f"{self.folder}/") for name in files)
                ours = cluster or "_Actor" in words or bool(logs & files)
                if inside and ours and entry.name != str(os.getpid()):
                    found.append(f"{entry.name} {words[:60]}")
            if not found or time.monotonic() > end:
                return found
            time.sleep(0.2)


def main() -> int:
    """Parse the command line and run the cases; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cluster", type=int, nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cluster:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Ray's own
            serve(*options.cluster)
        return 0
    os.environ.update(_LOOPBACK)  # before Ray is imported, for the commands
    preload()
    rng, faults = random.Random(options.seed), 0
    with TemporaryDirectory(prefix="few-", ignore_cleanup_errors=True) as folder:
        for index in range(options.count):
            case = Case(index, Path(folder, str(index)), rng)
            case.play()
            print(case, flush=True)
            faults += len(case.faults)
    print(f"{options.count} cases, {faults} violations")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
