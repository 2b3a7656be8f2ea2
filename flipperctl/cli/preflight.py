"""What is checked of a training before Hydra makes a directory.

In: the words of the command. Out: nothing, or the error that refuses the request.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig


def plain(overrides: list[str]) -> bool:
    """Return whether there are no options of Hydra among the words."""
    return not any(override.startswith("-") for override in overrides)


def check_single(overrides: list[str]) -> None:
    """Refuse lists of values, which make several runs.

    Raises:
        ConfigError: a setting has several values.
    """
    from flipperctl.cli.hydra.errors import convert_hydra_errors
    from flipperctl.cli.hydra.overrides import parse_overrides
    from flipperctl.errors import ConfigError

    with convert_hydra_errors():
        parsed = parse_overrides(o for o in overrides if "=" in o and not o.startswith("-"))
    for override in parsed:
        if override.is_sweep_override():
            key, _, value = str(override.input_line).partition("=")
            raise ConfigError(
                f"{override.input_line}: several values make several runs; add -m for them, or "
                f"brackets if the setting is a list: {key}=[{value}]"
            )


def check(overrides: list[str], *, compose: bool) -> None:
    """Refuse a wrong request; with ``compose``, the composed configurations are checked, too.

    Raises:
        RequestError: a word is wrong, or the terrain, device or network cannot be used.
        KeyboardInterrupt: Ctrl-C was pressed.
    """
    from flipperctl.cli.hydra.combinations import interval_probes
    from flipperctl.cli.hydra.compose import compose_train
    from flipperctl.cli.hydra.errors import convert_hydra_errors
    from flipperctl.cli.hydra.overrides import (
        check_folders,
        check_mappings,
        check_once,
        check_words,
    )
    from flipperctl.runs.interrupts import interrupts

    typed_alone = plain(overrides)
    if typed_alone:  # with options, words may be their values
        check_words(overrides)
    assigned = [o for o in overrides if "=" in o and not o.startswith("-")]
    check_once(assigned)
    with convert_hydra_errors():
        check_folders(assigned)
        check_mappings(assigned)
    # Hydra's rarer options may bring other configuration files; then the job itself checks.
    if compose and typed_alone:
        own = [o for o in overrides if not o.lstrip("+~").startswith("hydra")]
        with convert_hydra_errors():
            probes = [own, *interval_probes(own)]
        # pymunk would swallow a KeyboardInterrupt that is raised while it frees a body.
        with interrupts("stopping …") as stop:
            for config in itertools.chain.from_iterable(map(compose_train, probes)):
                if stop():
                    break
                check_device(config)
                _check_terrain(config)
                _check_network(config, _recorded_decisions(config))
        if stop():
            raise KeyboardInterrupt


def check_device(config: TrainConfig) -> None:
    """Refuse a device that torch cannot use.

    Raises:
        ConfigError: it cannot be used.
    """
    import torch

    from flipperctl.errors import ConfigError

    try:
        torch.empty(0, device=config.device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"device: {config.device!r} cannot be used: {reason}") from error


def _check_terrain(config: TrainConfig) -> None:
    from flipperctl.env.flipper_env import FlipperEnv

    FlipperEnv(config=config.environment()).reset(seed=0)


def _recorded_decisions(config: TrainConfig) -> int:
    from flipperctl.training.recorded import read_teacher

    recording = read_teacher(config)
    return 0 if recording is None else recording.decisions


def _check_network(config: TrainConfig, recorded: int) -> None:
    from flipperctl.agent.demand import check_demand
    from flipperctl.api import ACTIONS

    check_demand(
        *(config.network, config.perception, len(ACTIONS), config.agent),
        config.train.decisions + recorded,
        labelled=config.teacher.teaches,
    )
