"""Explain an unknown option by the setting it stands for, or by a close match."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from flipperctl.messages import closest

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig


def explain(
    name: str,
    value: str,
    known: Sequence[str],
    primary: str | None,
    default: Callable[[], TrainConfig],
    *,
    takes_run: bool = False,
) -> str:
    """Return the error text for the option ``name``, which was typed with ``value``.

    ``known`` are the subcommand's options; ``primary`` names the configuration of its overrides,
    and ``default`` returns that of a training without overrides. ``takes_run``: whether the
    subcommand takes a run or a policy without an option.
    """
    key = name.lstrip("-").replace("-", "_")
    found = list(_settings(key, primary, default)) if primary else []
    if found:
        shown = " or ".join(
            shlex.quote(f"{path}={value}") if value else f"{path}=…" for path in found
        )
        return f"no such option: {name}; settings are written as {shown}"
    if name == "--checkpoint" and takes_run:
        return f"no such option: {name}; write {value or 'the run or policy'} alone"
    if name == "--checkpoint" and primary == "train":
        return (
            f"no such option: {name}; agent.start_from={value or 'RUN_OR_FILE'} begins with its "
            "weights, and --resume goes on with a run"
        )
    options = {option.removeprefix("--"): option for option in known if option.startswith("--")}
    close = closest(name.lstrip("-"), options)
    return f"no such option: {name}" + (f"; did you mean {options[close]!r}?" if close else "")


def _settings(key: str, primary: str, default: Callable[[], TrainConfig]) -> Iterator[str]:
    """Yield the paths of settings that equal ``key`` or end with it."""
    from flipperctl import plugins
    from flipperctl.config import EvalConfig
    from flipperctl.config.defaults import CHOICES
    from flipperctl.config.describe import paths_named

    plugins.load()
    config = default()
    sections = type(config).model_fields if primary == "train" else EvalConfig.model_fields
    yield from paths_named(key, config, sections, CHOICES)
