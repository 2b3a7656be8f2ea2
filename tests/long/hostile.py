"""Calls from folders whose files are named like modules; the caller's process stays as it was.

``python -m tests.long.hostile --count 100 --seed 1`` draws such files, and calls of the Python
interface that play in several processes. It compares results with those of one process in an empty
folder, and the caller's state after each call, which may be refused, with that before it.
"""

import argparse
import contextlib
import json
import locale
import multiprocessing
import os
import random
import signal
import sys
import time
import warnings
from collections.abc import Callable
from multiprocessing import forkserver
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.long.forked import LIMIT, preload

PACKAGES = ("flipperctl", "flipperctl_plugins", "gymnasium", "numpy", "pydantic", "torch", "yaml")
_TRAIN: dict[str, Any] = {
    "terrain": "step",
    "agent": {"learning_starts": 50, "batch_size": 32},
    "seed": 3,
}
_BUDGET = {"decisions": 150, "validation_episodes": 1, "regret_episodes": 0}


def evaluate(jobs: int) -> Any:
    """Return the results of an evaluation."""
    import flipperctl

    result = flipperctl.evaluate("okada", terrain="step", episodes=3, jobs=jobs, progress=False)
    return result.to_dict()


def train(jobs: int) -> Any:
    """Return the results of a training whose episodes one or several processes play."""
    import flipperctl

    settings = {**_TRAIN, "train": {**_BUDGET, "workers": jobs}}
    run = flipperctl.train(directory="run", progress=False, **settings)
    return {key: run.summary[key] for key in ("decisions", "finished")}


def fail(jobs: int) -> Any:
    """Return the errors of calls that are refused, at once or in a worker."""
    import flipperctl
    from flipperctl.errors import FlipperctlError

    calls: list[Callable[[], object]] = [
        lambda: flipperctl.evaluate("okada", terrain="nowhere", episodes=1, jobs=jobs),
        lambda: flipperctl.train(**_TRAIN, train={"decisions": -1}),
        lambda: flipperctl.load("nothing.safetensors"),
    ]
    found = []
    for call in calls:
        with contextlib.suppress(FlipperctlError):
            call()
            found.append("nothing was refused")
    return found


CALLS: dict[str, Callable[[int], Any]] = {"evaluate": evaluate, "train": train, "fail": fail}


def state() -> dict[str, Any]:
    """Return what of this process a call must leave alone."""
    import numpy as np
    import torch

    return {
        "mask": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())),
        "handlers": [repr(signal.getsignal(number)) for number in signal.valid_signals()],
        "environment": dict(os.environ),
        "folder": str(Path.cwd()),
        "path": [*sys.path, *sys.argv],
        "warnings": repr(warnings.filters),
        "start method": multiprocessing.get_start_method(allow_none=True),
        "fork server": [
            forkserver._forkserver._preload_modules,  # type: ignore[attr-defined]
            forkserver._forkserver._forkserver_pid,  # type: ignore[attr-defined]
        ],
        "threads": [torch.get_num_threads(), torch.get_num_interop_threads()],
        "torch": [str(torch.get_default_dtype()), torch.is_grad_enabled()],
        "random": repr((random.getstate(), np.random.get_state(), torch.get_rng_state().sum())),  # noqa: NPY002
        "floats": [np.geterr(), locale.setlocale(locale.LC_ALL)],
    }


def fill(folder: Path, rng: random.Random) -> list[str]:
    """Make files and folders that are named like modules; return the names."""
    names = rng.sample(sorted(sys.stdlib_module_names), 40)
    names += rng.sample(PACKAGES, 4)
    for name in names:
        if rng.random() < 0.8:
            (folder / f"{name}.py").write_text(rng.choice(["x = 1\n", "import nothing_at_all\n"]))
        else:
            (folder / name).mkdir()
    return names


def play(name: str, jobs: int, folder: Path) -> dict[str, Any] | None:
    """Call in a forked process in ``folder``; return what it found, or None if it hangs."""
    target = folder.with_suffix(".json")
    pid = os.fork()
    if not pid:
        code = 1
        try:
            os.chdir(folder)
            log = os.open(folder.with_suffix(".log"), os.O_WRONLY | os.O_CREAT)
            os.dup2(log, 1)
            os.dup2(log, 2)
            before = state()
            found = CALLS[name](jobs)
            after = state()
            changed = [key for key in before if before[key] != after[key]]
            target.write_text(json.dumps({"found": found, "changed": changed}))
            code = 0
        except BaseException:  # noqa: BLE001 (the child must never return into the parent's code)
            import traceback

            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    end = time.monotonic() + LIMIT
    while not os.waitpid(pid, os.WNOHANG)[0]:
        if time.monotonic() > end:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return None
        time.sleep(0.01)
    if not target.exists():
        return {"error": folder.with_suffix(".log").read_text()[-2000:]}
    done: dict[str, Any] = json.loads(target.read_text())
    return done


def run(count: int, seed: int, folder: Path) -> int:
    """Play the cases; return the exit code."""
    preload()
    rng, violations = random.Random(seed), 0
    expected: dict[str, Any] = {}
    for index in range(count):
        name = list(CALLS)[index % len(CALLS)]
        if name not in expected:
            (folder / name).mkdir()
            expected[name] = play(name, 1, folder / name)
        here = folder / f"case{index}"
        here.mkdir()
        names, jobs = fill(here, rng), rng.choice([1, 2, 2])
        found = play(name, jobs, here)
        if found != expected[name] or found is None or found.get("changed") != []:
            violations += 1
            print(f"{name}, {jobs} jobs, {names}: {found}\n{expected[name]}", file=sys.stderr)
    print(f"hostile folders: {count} cases, {violations} violations")
    return int(violations > 0)


def main() -> None:
    """Read the options and play the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with TemporaryDirectory(prefix="hostile-") as name:
        sys.exit(run(given.count, given.seed, Path(name)))


if __name__ == "__main__":
    main()
