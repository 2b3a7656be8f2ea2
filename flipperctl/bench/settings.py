"""The inputs, sizes and results of measures, and the machine that they run on.

In: one number per round, or None for a run that did not finish in time, which counts as larger than
any number. Out: medians, quartiles and ratios as plain dictionaries for the JSON document, with the
raw numbers, versions, processor, load and date.
"""

from __future__ import annotations

import math
import os
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field

from flipperctl import __version__
from flipperctl.api import Settings
from flipperctl.config import TrainConfig, parse, resolver, with_overrides
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError
from flipperctl.rollout.children import python_environment

PACKAGES = (
    "torch",
    "numpy",
    "pymunk",
    "gymnasium",
    "numba",
    "stable-baselines3",
    "onnxruntime",
    "ray",
)


def machine() -> dict[str, Any]:
    """Return date, versions (None if not installed), system, processor, cores and load."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "flipperctl": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "cores_allowed": _allowed_cores(),
        "load_average": load(),
    }


def load() -> list[float] | None:
    """Return the load averages over the last 1, 5 and 15 minutes [-]; None if unavailable."""
    return list(os.getloadavg()) if hasattr(os, "getloadavg") else None


def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's model name."""
    if listing.is_file():
        for line in listing.read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip().lower() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _allowed_cores() -> int | None:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count()


def output(command: Sequence[str], what: str) -> str:
    """Run a command to its end and return its stdout.

    Raises:
        MissingExtraError: the command failed because an extra is not installed.
        FlipperctlError: the command failed otherwise; the text has ``what`` and its last line.
    """
    # All callers run this interpreter with flipperctl's own modules.
    done = subprocess.run(  # noqa: S603
        command, env=python_environment(), capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return done.stdout
    reason = (done.stderr.strip().splitlines() or ["it wrote no message"])[-1]
    if done.returncode == MissingExtraError.exit_code and "install flipperctl[" in reason:
        raise MissingExtraError(reason.removeprefix("error: "))
    raise FlipperctlError(f"{what} failed: {reason}")


SECTION = "bench."
"""Prefix of the keys of the sizes among overrides of the training."""

ENGINE_GROUNDS = ("flat", "stair", "plum", "paper_stair")
"""Terrains on which engines are timed: level ground, edges, many edges, the paper's scene."""


class CommonSettings(Settings):
    """The sizes that measures of several suites share."""

    repeats: int = Field(
        10, ge=2, le=10_000, description="rounds, with all contestants in each [-]"
    )
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of all random numbers [-]")
    controller: str = Field("okada", description="controller plugin that drives [-]")
    updates: int = Field(200, ge=1, le=100_000, description="updates of a learner per round [-]")
    batch_sizes: tuple[int, ...] = Field(
        (32, 128, 512), min_length=1, description="transitions per update [-]"
    )
    transitions: int = Field(
        20_000, ge=100, le=1_000_000, description="transitions in a learner's replay [-]"
    )


COMMON_SMALL: Mapping[str, Any] = {
    "repeats": 2,
    "updates": 4,
    "batch_sizes": (32,),
    "transitions": 300,
}
"""Replacements of the defaults with ``--small``, which tests in seconds that everything works."""


class BenchSettings(CommonSettings):
    """The sizes of the measures of ``flipperctl bench``."""

    episodes: int = Field(4, ge=1, le=1000, description="engines: episodes per round [-]")
    families: int = Field(
        len(ENGINE_GROUNDS),
        ge=1,
        le=len(ENGINE_GROUNDS),
        description=f"engines: terrains, the first of {', '.join(ENGINE_GROUNDS)} [-]",
    )
    calls: int = Field(5000, ge=10, le=10_000_000, description="latency: calls per round [-]")
    decisions: int = Field(
        2000,
        ge=100,
        le=10_000_000,
        description="latency: decisions of a short run; scaling: decisions of each worker [-]",
    )
    workers: tuple[Annotated[int, Field(ge=1, le=1024)], ...] = Field(
        (),
        description="scaling: numbers of workers; none: the powers of two up to the number of "
        "cores [-]",
    )


SMALL: Mapping[str, Any] = {
    **COMMON_SMALL,
    "episodes": 1,
    "families": 1,
    "calls": 200,
    "decisions": 150,
}


Sizes = TypeVar("Sizes", bound=CommonSettings)
SizesOfMeasure = TypeVar("SizesOfMeasure", bound=CommonSettings, covariant=True)


@dataclass(frozen=True)
class Bench(Generic[SizesOfMeasure]):
    """Inputs of a measure."""

    config: TrainConfig
    settings: SizesOfMeasure
    report_progress: Callable[[str, float], None] = lambda what, fraction: None
    """Called with a text on the current step and the finished fraction of the measure."""
    overrides: tuple[str, ...] = ()
    """Overrides from which ``config`` was composed, for processes that compose it again."""


@dataclass(frozen=True)
class Suite(Generic[Sizes]):
    """The measures of a command."""

    package: str
    """Package with a module for each measure."""
    measures: tuple[str, ...]
    sizes: type[Sizes]
    small: Mapping[str, Any]
    """Replacements of the defaults of ``sizes`` with ``--small``."""

    def settings(self, *, small: bool, changes: Mapping[str, Any]) -> Sizes:
        """Return the default sizes, or the small ones, with ``changes`` applied.

        Raises:
            ConfigError: a key or a value is not allowed, or there is no such controller.
        """
        try:
            found = with_overrides(parse(self.sizes, self.small if small else {}), changes)
        except ConfigError as error:
            raise ConfigError(f"{SECTION}{error}") from error
        resolver.get("controller", found.controller, f"{SECTION}controller")
        return found


Values = Sequence[float | None]


def quantity(values: Values, unit: str) -> dict[str, Any]:
    """Return median and quartiles; one that falls on a run without a number is None."""
    low, median, high = (_finite(quantile(values, q)) for q in (0.25, 0.5, 0.75))
    return {"unit": unit, "median": median, "low": low, "high": high, "values": list(values)}


def ratio(numerator: Values, denominator: Values) -> dict[str, Any]:
    """Return the ratio of the medians, and the quartiles of the ratios of the rounds.

    The ratio is None if a median is None. Rounds in which both values are None are left out.
    """
    medians = quantile(numerator, 0.5), quantile(denominator, 0.5)
    ratios = [_divided(a, b) for a, b in zip(numerator, denominator, strict=True)]
    known = [value for value in ratios if not math.isnan(value)]
    low, high = (_finite(quantile(known, q)) if known else None for q in (0.25, 0.75))
    of_medians = medians[0] / medians[1] if all(map(math.isfinite, medians)) else None
    return {"ratio": of_medians, "low": low, "high": high, "rounds": len(known)}


def quantile(values: Values, q: float) -> float:
    """Return the quantile, interpolated linearly, with None counted as infinite."""
    ordered = sorted(math.inf if v is None else float(v) for v in values)
    position = q * (len(ordered) - 1)
    index = math.floor(position)
    fraction = position - index
    if fraction == 0:
        return ordered[index]
    lower, upper = ordered[index], ordered[index + 1]
    return math.inf if math.isinf(upper) else lower + fraction * (upper - lower)


def measure_in_turn(
    contestants: Mapping[str, Callable[[], float]],
    rounds: int,
    report_progress: Callable[[float], None] = lambda fraction: None,
) -> dict[str, list[float]]:
    """Run all contestants in each round (A B A B …); return the results of each, by round.

    They take turns so that a temporarily slow machine slows all of them. ``report_progress`` is
    called with the finished fraction of the rounds.
    """
    found: dict[str, list[float]] = {name: [] for name in contestants}
    for index in range(rounds):
        for name, run in contestants.items():
            found[name].append(run())
        report_progress((index + 1) / rounds)
    return found


def _divided(numerator: float | None, denominator: float | None) -> float:
    if numerator is None:
        return math.nan if denominator is None else math.inf
    return 0.0 if denominator is None else numerator / denominator


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
