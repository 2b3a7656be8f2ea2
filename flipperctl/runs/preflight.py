"""Check a training before it starts: its device, terrain, network and memory.

In: a configuration. Out: nothing, or an error.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from flipperctl.errors import ConfigError

if TYPE_CHECKING:
    from flipperctl.checkpoint.document import State
    from flipperctl.config import Train, TrainConfig

_RESUMABLE = ("train.", "device", "collector", "logger")
"""What the overrides of a resumed run begin with."""
_JUDGING = ("best_by", "validation_episodes", "validation_seed")
"""Settings of ``train`` that hold from the first validation on, of which all choose the best."""


def check(config: TrainConfig) -> None:
    """Refuse a training that cannot begin.

    Raises:
        RequestError: the terrain, device, teacher or network cannot be used.
    """
    check_device(config)
    _check_terrain(config)
    _check_network(config, _recorded_decisions(config))
    _check_start(config)


def check_resumable(words: Iterable[str]) -> None:
    """Refuse overrides of a resumed run that would make it another run.

    Raises:
        ConfigError: an override sets anything but ``train``, device, collector or loggers.
    """
    for word in words:
        if "=" not in word or not word.startswith(_RESUMABLE):
            raise ConfigError(
                f"{word!r}: a resumed run keeps its configuration; only train.<field>=…, "
                "device=…, collector=… and logger=… can be given with --resume"
            )


def require_kept(before: Train, after: Train, state: State) -> None:
    """Refuse changes of a run in this state that would mix ways of judging or collecting.

    Raises:
        ConfigError: one of these settings differs.
    """

    def word(value: object) -> str:
        return str(value).lower() if isinstance(value, bool) else f"{value}"

    kept_from_now = [*(_JUDGING if state.validations else ()), *(["record"] * (state.episode > 0))]
    if state.orders:  # workers have begun episodes
        kept_from_now.append("mode")
    for name in kept_from_now:
        kept, given = getattr(before, name), getattr(after, name)
        if given != kept:
            raise ConfigError(
                f"train.{name}={word(given)}: the run goes on with train.{name}={word(kept)}, "
                "which holds for all of it; leave it out, or begin a new run"
            )


def check_device(config: TrainConfig) -> None:
    """Refuse a device that torch cannot use.

    Raises:
        ConfigError: it cannot be used.
    """
    import torch

    try:
        torch.empty(0, device=config.device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"device: {config.device!r} cannot be used: {reason}") from error


def _check_terrain(config: TrainConfig) -> None:
    from flipperctl.env.flipper_env import FlipperEnv
    from flipperctl.env.repeating import require_repeatable

    env = FlipperEnv(config=config.environment())
    env.reset(seed=0)
    require_repeatable(env, 0)


def _recorded_decisions(config: TrainConfig) -> int:
    from flipperctl.training.recorded import read_teacher

    recording = read_teacher(config)
    return 0 if recording is None else recording.decisions


def _check_start(config: TrainConfig) -> None:
    from flipperctl.training.starting import read_start, read_values

    read_start(config)
    read_values(config)


def _check_network(config: TrainConfig, recorded: int) -> None:
    from flipperctl.agent.contract import check_contract
    from flipperctl.agent.demand import check_demand
    from flipperctl.api import ACTIONS

    check_demand(
        *(config.network, config.perception, len(ACTIONS), config.agent),
        config.train.decisions + recorded,
        labelled=config.teacher.teaches,
    )
    check_contract(config.network, config.perception)
