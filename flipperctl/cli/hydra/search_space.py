"""What a search samples, read from Hydra's overrides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.errors import ConfigError

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution


def search_space(overrides: Overrides) -> tuple[dict[str, BaseDistribution], list[str]]:
    """Return the distributions that Optuna samples, by key, and the fixed overrides.

    Raises:
        ConfigError: there is nothing to sample, or a logarithmic interval reaches zero.
    """
    from optuna.distributions import (
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )

    space: dict[str, BaseDistribution] = {}
    fixed = []
    for override in overrides.parsed:
        key = override.get_key_element()
        if override.is_interval_sweep():
            sweep: Any = override.value()
            whole = isinstance(sweep.start, int) and isinstance(sweep.end, int)
            try:
                space[key] = (IntDistribution if whole else FloatDistribution)(
                    sweep.start, sweep.end, log="log" in sweep.tags
                )
            except ValueError as error:
                raise ConfigError(f"{override.input_line}: {error}") from error
        elif override.is_sweep_override():
            space[key] = CategoricalDistribution(list(override.sweep_string_iterator()))
        else:
            fixed.append(str(override.input_line))
    if not space:
        raise ConfigError(
            "hydra/sweeper=optuna has nothing to search; give an interval or a list, as in "
            "'agent.learning_rate=tag(log,interval(1e-4,3e-3))' or agent.batch_size=64,128"
        )
    return space, fixed
