"""The sizes, inputs and ratios of the developers' benchmarks, and their command."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from flipperctl.api import Engine, Settings
from flipperctl.checkpoint.results import json_result
from flipperctl.commands.bench import split_arguments
from flipperctl.commands.speed import load, machine, number
from flipperctl.config import TrainConfig, parse, resolver, with_overrides
from flipperctl.config.words import with_flags
from flipperctl.errors import ConfigError
from flipperctl.requests.compose import compose_train, only_one
from flipperctl.requests.text import from_words
from flipperctl.sim.planar import Planar
from flipperctl.terminal.progress import steps_progress
from flipperctl.terminal.streams import print_note, show
from flipperctl.text.show import NONE, Column, Table, console, print_table

Values = Sequence[float | None]
"""One number for each round; None for a run that did not finish, which is larger than any."""
SECTION = "bench."
"""Prefix of the keys of the sizes among overrides of the training."""
MEASURES = (
    *("engines", "learner", "latency", "scaling", "physics", "accuracy", "lookahead", "lidar"),
    *("updates", "solve", "startup"),
)
FAMILIES = (
    *("step", "stair", "building_stair", "ramp", "uplift"),
    *("gap", "wave", "rubble", "pallet", "plum"),
)
"""Terrains of the generalist's training, for benchmarks over all kinds of ground."""
MISSING = "stable-baselines3 is not installed; install flipperctl[sb3]"
"""Why a comparison with another learner was not made."""

SMALL: Mapping[str, Any] = {
    "repeats": 2,
    "updates": 4,
    "batch_sizes": (32,),
    "transitions": 300,
    "calls": 200,
    "decisions": 150,
    "episodes": 1,
    "families": 1,
    "starts": 1,
    "seeds": 1,
    "limit": 2.0,
    "validate_every": 100,
    "validation_episodes": 2,
    "commands": 1,
}
"""Values that replace the defaults with ``--small``, for a check that takes seconds."""


class BenchmarkSettings(Settings):
    """The sizes of the benchmarks."""

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

    episodes: int = Field(
        4,
        ge=1,
        le=1000,
        description="engines, physics, lidar: episodes per round; lookahead: episodes per terrain "
        "and controller whose decisions are predicted [-]",
    )
    starts: int = Field(
        20, ge=1, le=10_000, description="accuracy: starts per scene, episodes per terrain [-]"
    )
    families: int = Field(
        len(FAMILIES),
        ge=1,
        le=len(FAMILIES),
        description=f"accuracy, lookahead: terrains, the first of {', '.join(FAMILIES)}; engines: "
        "terrains of its own [-]",
    )
    seeds: int = Field(5, ge=1, le=100, description="solve: seeds per contestant [-]")
    limit: float = Field(600.0, gt=0, le=86_400, description="solve: time limit of a run [s]")
    validate_every: int = Field(
        1000, ge=1, le=1_000_000, description="solve: decisions between validations [-]"
    )
    validation_episodes: int = Field(
        100,
        ge=1,
        le=10_000,
        description="solve: episodes per validation, which must all succeed [-]",
    )
    in_a_row: int = Field(3, ge=1, le=100, description="solve: consecutive such validations [-]")
    commands: int = Field(
        100, ge=1, le=100, description="startup: largest number of commands, in help order [-]"
    )


@dataclass(frozen=True)
class Benchmark:
    """Inputs of a benchmark."""

    config: TrainConfig
    settings: BenchmarkSettings
    report_progress: Callable[[str, float], None] = lambda what, fraction: None
    """Called with a text on the current step and the finished fraction of the measure."""
    overrides: tuple[str, ...] = ()
    """Overrides from which ``config`` was composed, for processes that compose it again."""


def sizes(*, small: bool, changes: Mapping[str, Any]) -> BenchmarkSettings:
    """Return the default sizes, or the small ones, with ``changes`` applied."""
    try:
        found = with_overrides(parse(BenchmarkSettings, SMALL if small else {}), changes)
    except ConfigError as error:
        raise ConfigError(f"{SECTION}{error}") from error
    resolver.get("controller", found.controller, f"{SECTION}controller")
    return found


def run(
    words: Sequence[str], repeats: str | None, output: Path | None, *, small: bool, as_json: bool
) -> None:
    """Run the measures named by the words; print their tables, or one JSON document."""
    measures, typed = split_arguments(words, MEASURES)
    overrides = with_flags(typed, "bench", repeats=repeats)
    every = from_words(overrides)
    own = every.where(lambda key: key.startswith(SECTION)).values()
    others = every.where(lambda key: not key.startswith(SECTION))
    changes = {key.removeprefix(SECTION): value for key, value in own.items()}
    settings = sizes(small=small, changes=changes)
    inputs = Benchmark(only_one(compose_train(others)), settings, overrides=tuple(others.words))
    document = run_measures(measures, inputs, overrides, output)

    def printed() -> None:
        for name, found in document["measures"].items():
            print_table(table(name, found), console())

    show(document, printed, as_json=as_json)


def run_measures(
    measures: Sequence[str], inputs: Benchmark, overrides: Sequence[str], output: Path | None
) -> dict[str, Any]:
    """Run the measures; return their results as plain data, with the ``overrides``."""
    document: dict[str, Any] = {
        "machine": machine(),
        "settings": inputs.settings.model_dump(mode="json"),
        "overrides": list(overrides),
        "measures": {},
    }
    with json_result(output, "bench") as write:
        for name in measures:
            with steps_progress(name) as report:
                measure = import_module(f"benchmarks.{name}").measure
                found = measure(replace(inputs, report_progress=report))
            document["measures"][name] = {**found, "load_average": load()}
            for text in found.get("missing", ()):
                print_note(f"{name}: {text}")
            write(document)  # after each measure, since the next may take an hour
    return document


def table(name: str, measured: Mapping[str, Any]) -> Table:
    """Return the table of a measure: medians with quartiles, then ratios if it has any.

    The text ``unfinished`` of a measure replaces a median that falls on an unfinished run.
    """

    def text(value: float | None, missing: str = NONE) -> str:
        return missing if value is None else number(value)

    def row(what: str, numbers: Mapping[str, Any], median: str, unit: str) -> dict[str, Any]:
        known = numbers["low"] is not None or numbers["high"] is not None
        spread = f"{text(numbers['low'])} … {text(numbers['high'])}" if known else NONE
        return {"what": what, "median": median, "range": spread, "unit": unit}

    # Medians with their quartiles, then ratios below a line
    rows = [
        row(what, q, text(q["median"], measured.get("unfinished", NONE)), q["unit"])
        for what, q in measured["quantities"].items()
    ]
    for at, (what, item) in enumerate(measured.get("ratios", {}).items()):
        rows.append(row(what, item, text(item["ratio"]), "×") | {"line": at == 0})
    columns = (
        Column("what", "quantity", named=True),
        Column("median", "median"),
        Column("range", "quartiles"),
        Column("unit", "unit"),
    )
    return Table(columns, rows, f"{name}: {measured['about']}")


def quantity(values: Values, unit: str) -> dict[str, Any]:
    """Return median and quartiles; a value that falls on a run without a number is None."""
    low, median, high = (finite(quantile(values, q)) for q in (0.25, 0.5, 0.75))
    return {"unit": unit, "median": median, "low": low, "high": high, "values": list(values)}


def quantile(values: Values, q: float) -> float:
    """Return the quantile, interpolated linearly, with None counted as infinite."""
    ordered = sorted(math.inf if v is None else float(v) for v in values)
    lower, fraction = divmod(q * (len(ordered) - 1), 1)
    first = ordered[int(lower)]
    return first + fraction * (ordered[int(lower) + 1] - first) if fraction else first


def finite(value: float) -> float | None:
    """Return None for infinity."""
    return value if math.isfinite(value) else None


def ratio(numerator: Values, denominator: Values) -> dict[str, Any]:
    """Return the ratio of the medians, and the quartiles of the ratios of the rounds.

    The ratio is None if a median is None. Rounds in which both values are None are left out.
    """
    medians = quantile(numerator, 0.5), quantile(denominator, 0.5)
    ratios = [_divided(a, b) for a, b in zip(numerator, denominator, strict=True)]
    known = [value for value in ratios if not math.isnan(value)]
    low, high = (finite(quantile(known, q)) if known else None for q in (0.25, 0.75))
    of_medians = medians[0] / medians[1] if all(map(math.isfinite, medians)) else None
    return {"ratio": of_medians, "low": low, "high": high, "rounds": len(known)}


def _divided(numerator: float | None, denominator: float | None) -> float:
    if numerator is None:
        return math.nan if denominator is None else math.inf
    return 0.0 if denominator is None else numerator / denominator


def milliseconds(work: Callable[[], object]) -> Callable[[], float]:
    """Return a function that does the work and returns the time on the clock [ms]."""

    def clock() -> float:
        begun = time.perf_counter()
        work()
        return 1e3 * (time.perf_counter() - begun)

    return clock


def planar(chosen: Engine) -> Planar:
    """Return the engine if it is the planar one."""
    if not isinstance(chosen, Planar):
        raise ConfigError(f"sim: this is measured with sim=planar only; got {chosen.plugin_name}")
    return chosen
