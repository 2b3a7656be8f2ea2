"""How fast training, evaluation and one decision are on this machine.

In: a training configuration. Out: plain data with the numbers of every round, medians, quartiles,
versions, processor and load. ``python -m flipperctl.commands.speed POLICY CALLS SEED`` times the
decisions of an exported policy alone, in a process without torch and pymunk, as on a robot. So
everything heavy is imported inside functions.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from flipperctl.errors import FlipperctlError, MissingExtraError, RequestError
from flipperctl.process import entry

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig
    from flipperctl.text.show import Table

HEAVY = ("torch", "pymunk", "hydra", "gymnasium", "matplotlib")
_WARM_UP = 100  # calls
_POLICY = "okada"
"""Controller whose episodes are timed."""
Report = Callable[[str, float], None]
"""Called with the current step and the finished fraction of a measure."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    repeats: int = 10
    decisions: int = 2000
    """Decisions of a training in each round."""
    episodes: int = 4
    calls: int = 5000
    """Decisions of an exported policy in each round."""


SMALL = Sizes(repeats=2, decisions=150, episodes=1, calls=200)
"""Tests in seconds that everything works."""


def training(config: TrainConfig, sizes: Sizes, report: Report) -> dict[str, Any]:
    """Measure decisions per second [1/s] of one training, in successive parts of equal length."""
    from flipperctl.config import with_overrides
    from flipperctl.training.trainer import Trainer

    # One long training, cut into equal parts afterwards, so that it starts but once
    total = sizes.decisions * sizes.repeats
    begun = [(0, 0.0)]

    def episode(row: Mapping[str, Any]) -> None:
        begun.append((row["decision"], time.perf_counter()))
        report("training", row["decision"] / total)

    def ignored(*arguments: object) -> None:
        """Take what a listener is told besides."""

    watch: Any = SimpleNamespace(episode=episode, validation=ignored, note=ignored, close=ignored)
    with TemporaryDirectory(prefix="flipperctl-bench-") as folder:
        trainer = Trainer(with_overrides(config, _short(total)), Path(folder), [watch])
        Path(folder, "checkpoints").mkdir()
        trainer.run()
    import numpy as np

    # The times at which each part begins and ends lie between two episodes.
    decisions, times = zip(*begun[1:], strict=True)
    marks = np.interp(np.linspace(decisions[0], decisions[-1], sizes.repeats + 1), decisions, times)
    part = (decisions[-1] - decisions[0]) / sizes.repeats
    return {
        "about": "decisions per second of a training, its updates included",
        "quantities": {"training": quantity([part / t for t in np.diff(marks)], "1/s")},
    }


def _short(decisions: int) -> dict[str, Any]:
    return {
        "train.decisions": decisions,
        "train.validate_every": decisions,
        "train.validation_episodes": 1,
    }


def evaluation(config: TrainConfig, sizes: Sizes, report: Report) -> dict[str, Any]:
    """Measure simulated time over CPU time [-] of episodes in every installed engine."""
    from flipperctl.api.plugin import registered_names
    from flipperctl.config import with_overrides
    from flipperctl.env.flipper_env import FlipperEnv
    from flipperctl.policies.source import load_policy
    from flipperctl.rollout.episode import EvaluationSeeds, decisions

    # Each engine plays the same episodes, compiled before the clock runs.
    environment, missing = config.environment(), list[str]()
    clocks: dict[str, Callable[[], float]] = {}
    for engine in registered_names("sim"):
        variant = (
            environment
            if engine == environment.sim.plugin_name
            else with_overrides(environment, {"sim": engine})
        )
        try:
            env = FlipperEnv(config=variant)
            policy = load_policy(_POLICY, "bench").build(variant)
            seeds = EvaluationSeeds.of(0, variant.terrain).first(sizes.episodes)

            def clock(env: FlipperEnv = env, policy: Any = policy, seeds: Any = seeds) -> float:
                simulated, begun = 0.0, time.process_time()
                for seed in seeds:
                    for _ in decisions(env, policy, seed):
                        pass
                    simulated += env.state.time
                return simulated / (time.process_time() - begun)

            clock()  # it compiles
        except MissingExtraError as error:
            missing.append(str(error))
        else:
            clocks[engine] = clock
    # In turn, so that a slow moment of the machine slows all of them
    speeds = measure_in_turn(clocks, sizes.repeats, lambda done: report("engines in turn", done))
    return {
        "about": f"simulated time per second of CPU time of episodes of {_POLICY}",
        "quantities": {f"evaluation.{name}": quantity(v, "-") for name, v in speeds.items()},
        "missing": missing,
    }


def decision(config: TrainConfig, sizes: Sizes, report: Report) -> dict[str, Any]:
    """Measure one decision of the exported policy [µs] on one thread, in a process of its own."""
    from flipperctl import checkpoint
    from flipperctl.config import with_overrides
    from flipperctl.export.policy import export
    from flipperctl.training.trainer import Trainer

    # A short training makes the policy, since only its size matters for the time.
    short = with_overrides(config, {**_short(SMALL.decisions), "train.mode": "exact"})
    rounds: list[dict[str, Any]] = []
    missing = []
    with TemporaryDirectory(prefix="flipperctl-bench-") as name:
        (best := Path(name, checkpoint.BEST)).parent.mkdir()
        report("a short training", 0.0)
        Trainer(short, Path(name)).run()
        try:
            export(checkpoint.read(best), policy := Path(name, "policy.onnx"))
            for done in range(sizes.repeats):
                report("decisions", done / sizes.repeats)
                rounds.append(clocked(policy, sizes.calls))
        except MissingExtraError as error:
            missing.append(str(error))
    values = {what: [timing[what] for timing in rounds] for what in ("median", "p99") if rounds}
    return {
        "about": "one decision of an exported policy on one thread, without torch and pymunk",
        "quantities": {f"decision.{what}": quantity(v, "µs") for what, v in values.items()},
        "missing": missing,
    }


MEASURES = {"training": training, "evaluation": evaluation, "decision": decision}


def clocked(policy: Path, calls: int, seed: int = 0) -> dict[str, Any]:
    """Time an exported policy in a process of its own: see ``time_decisions``.

    Raises:
        MissingExtraError: ONNX Runtime is not installed.
    """
    words = [sys.executable, "-m", "flipperctl.commands.speed", str(policy), str(calls), str(seed)]
    timing: dict[str, Any] = json.loads(output(words, "decision: the policy's own process"))
    return timing


def time_decisions(path: str, calls: int, seed: int) -> dict[str, object]:
    """Return ``median`` and ``p99`` [µs] of decisions, and the heavy packages ``imported``.

    The observations are of uneven ground, on which few policies warn.

    Raises:
        MissingExtraError: ONNX Runtime is not installed.
    """
    import numpy as np

    from flipperctl.runtime import policy as runtime

    policy = runtime.OnnxPolicy(path)
    shape = 256, policy.interface.size
    observations = np.random.default_rng(seed).uniform(-0.1, 0.1, shape).astype(np.float32)
    took = np.empty(calls)
    # The first calls are slower; their times are overwritten.
    for index in range(-_WARM_UP, calls):
        observation = observations[index % len(observations)]  # [m, rad]
        begun = time.perf_counter_ns()
        policy.act(observation)
        took[max(index, 0)] = (time.perf_counter_ns() - begun) / 1e3
    median, p99 = np.quantile(took, (0.5, 0.99))
    imported = [name for name in HEAVY if name in sys.modules]
    return {"median": float(median), "p99": float(p99), "imported": imported}


def output(command: Sequence[str], what: str) -> str:
    """Run a command of this interpreter with flipperctl's own modules; return its stdout.

    Raises:
        MissingExtraError: the command failed because an extra is not installed.
        FlipperctlError: the command failed otherwise; the text has ``what`` and its last line.
    """
    import subprocess

    from flipperctl.rollout.pool import python_environment

    # The environment makes the child find this flipperctl, whatever else is installed.
    done = subprocess.run(  # noqa: S603
        command, env=python_environment(), capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return done.stdout
    # The last line of a traceback says what is missing.
    reason = (done.stderr.strip().splitlines() or ["it wrote no message"])[-1]
    if done.returncode == MissingExtraError.exit_code and "pip install " in reason:
        raise MissingExtraError(reason.removeprefix("error: "))
    raise FlipperctlError(f"{what} failed: {reason}")


def machine() -> dict[str, Any]:
    """Return date, versions (None if not installed), system, processor, cores and load."""
    from flipperctl import __version__

    packages = ("torch", "numpy", "pymunk", "gymnasium", "numba", "onnxruntime", "ray")
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "flipperctl": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in packages},
        },
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "cores_allowed": len(affinity(0)) if affinity else os.cpu_count(),
        "load_average": load(),
    }


def load() -> list[float] | None:
    """Return the load averages over the last 1, 5 and 15 minutes [-]; None if unavailable."""
    return list(os.getloadavg()) if hasattr(os, "getloadavg") else None


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    listing = Path("/proc/cpuinfo")
    for line in listing.read_text().splitlines() if listing.is_file() else ():
        if line.lower().startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def quantity(values: Sequence[float], unit: str) -> dict[str, Any]:
    """Return the values of all rounds with their median and quartiles."""
    import numpy as np

    low, median, high = map(float, np.quantile(values, (0.25, 0.5, 0.75)))
    return {"unit": unit, "median": median, "low": low, "high": high, "values": list(values)}


def measure_in_turn(
    contestants: Mapping[str, Callable[[], float]],
    rounds: int,
    report: Callable[[float], None] = lambda fraction: None,
) -> dict[str, list[float]]:
    """Run all contestants in each round (A B A B …); return the results of each, by round.

    They take turns so that a temporarily slow machine slows all of them. ``report`` is called with
    the finished fraction of the rounds.
    """
    results: dict[str, list[float]] = {name: [] for name in contestants}
    for index in range(rounds):
        for name, run in contestants.items():
            results[name].append(run())
        report((index + 1) / rounds)
    return results


def table(name: str, measured: Mapping[str, Any]) -> Table:
    """Return the table of a measure: medians with quartiles."""
    from flipperctl.text.show import Column, Table

    rows = [
        {
            "what": what,
            "median": number(numbers["median"]),
            "range": f"{number(numbers['low'])} … {number(numbers['high'])}",
            "unit": numbers["unit"],
        }
        for what, numbers in measured["quantities"].items()
    ]
    columns = (
        Column("what", "quantity", named=True),
        Column("median", "median"),
        Column("range", "quartiles"),
        Column("unit", "unit"),
    )
    return Table(columns, rows, f"{name}: {measured['about']}")


def number(value: float) -> str:
    """Return a number with three significant digits, or as an integer from 100 upwards."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _main(words: list[str]) -> int:
    try:
        path, calls, seed = words
        numbers = int(calls), int(seed)
    except ValueError as error:
        raise RequestError(
            f"a policy, a number of calls and a seed are allowed, as in stair.onnx 1000 0; "
            f"got {' '.join(words) or 'nothing'}"
        ) from error
    print(json.dumps(time_decisions(path, *numbers)))
    return 0


if __name__ == "__main__":
    entry.run(lambda: _main(sys.argv[1:]))
