"""Expand the sweeps among the overrides: combinations of lists, probes of intervals.

In: overrides as the user typed them. Out: lists of overrides without lists.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import cast

from hydra.core.override_parser.types import IntervalSweep

from flipperctl.cli.hydra.config_store import CHOICES
from flipperctl.cli.hydra.overrides import check_mappings, parse_overrides
from flipperctl.errors import ConfigError


def combinations(overrides: Sequence[str]) -> Iterator[list[str]]:
    """Yield every combination of the values in lists; intervals are left out.

    Raises:
        OverrideParseException: Hydra cannot read one of the overrides.
        ConfigError: null is chosen where a name is needed, or a mapping is empty.
    """
    check_mappings(overrides)
    choices: list[list[str]] = []
    for override in parse_overrides(overrides):
        if override.key_or_group in CHOICES and str(override.input_line).endswith("=null"):
            raise ConfigError(f"{override.input_line}: null is no choice here; give a name")
        if override.is_interval_sweep():
            continue  # a sweeper samples it; the job checks the sampled value
        if override.is_sweep_override():
            key = override.get_key_element()
            choices.append([f"{key}={value}" for value in override.sweep_string_iterator()])
        else:
            choices.append([str(override.input_line)])
    for combination in itertools.product(*choices):
        yield list(combination)


def interval_probes(overrides: Sequence[str]) -> list[list[str]]:
    """Return the overrides with each interval at its ends, and at a value between them.

    The value between them reveals an interval of real numbers for an integer setting.
    """
    found = []
    for index, override in enumerate(parse_overrides(overrides)):
        interval = override.value()
        if isinstance(interval, IntervalSweep):
            start, end = cast("tuple[float, float]", (interval.start, interval.end))
            whole = isinstance(start, int) and isinstance(end, int)
            between = start if whole else start + 0.3819 * (end - start)
            before, after = overrides[:index], overrides[index + 1 :]
            key = override.get_key_element()
            found += [[*before, f"{key}={x}", *after] for x in (start, end, between)]
    return found
