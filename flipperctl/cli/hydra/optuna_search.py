"""``hydra/sweeper=optuna``: a resumable search over intervals and lists.

In: overrides, of which some are ``interval(…)``, ``tag(log,interval(…))`` or lists. Out: one
training for each trial. Optuna proposes, Hydra's launcher trains. (Hydra's own plugin,
hydra-optuna-sweeper 1.3, needs Optuna 2, whose storage fails with SQLAlchemy 2, and repeats every
trial after a restart.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from flipperctl.cli.hydra.compose import compose_train
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.hydra.sweeps import launched_by
from flipperctl.errors import ConfigError
from flipperctl.terminal.streams import print_note
from flipperctl.training.search import search
from flipperctl.training.search_space import Interval, SearchSettings, check_settings
from flipperctl.training.sweep import Sweep

_TASK = {"terrain", "conditions", "sim", "perception", "episode", "robot", "randomise"}
"""Sections and groups that change what validations are made of."""
_EXPERIMENT = "experiment"


def prepare(
    sweeper_settings: Mapping[str, Any],
    *,
    hydra_context: HydraContext,
    task_function: TaskFunction,
    config: DictConfig,
) -> SearchSweep:
    """Return the search that Hydra's configuration describes, with Hydra's launcher.

    Raises:
        MissingExtraError: Optuna is not installed.
        ConfigError: one of ``sweeper_settings`` is of the wrong type or out of bounds.
    """
    settings = check_settings(sweeper_settings)
    launcher = Plugins.instance().instantiate_launcher(
        config=config, hydra_context=hydra_context, task_function=task_function
    )
    return SearchSweep(settings, launched_by(launcher, config))


@dataclass(frozen=True)
class SearchSweep:
    """A search whose trials are jobs of Hydra."""

    settings: SearchSettings
    jobs: Sweep

    def run(self, arguments: Sequence[str]) -> None:
        """Train trial after trial; ``arguments`` are the user's overrides.

        Raises:
            RunHeldError: another process works in the sweep's folder.
        """
        sampled, fixed = Overrides.parse(arguments, check=False).sampled()
        _check_objective(sampled, fixed)
        if found := [key for key in sampled if _setting(key).split(".")[0] in _TASK]:
            print_note(
                f"note: {', '.join(found)} change what a training is judged on; the best trial may "
                "be the easiest"
            )
        search(self.settings, self.jobs, arguments, sampled, fixed, tell=print_note)


def _check_objective(sampled: Mapping[str, Interval | Sequence[str]], fixed: Sequence[str]) -> None:
    """Refuse a search whose trials have objectives that cannot be compared.

    Raises:
        ConfigError: it samples what the objective is or the draws that it is measured on, or
            rewards while it is their sum.
    """
    for key in sampled:
        setting = _setting(key)
        if setting == "train.best_by" or setting.startswith("train.validation_"):
            raise ConfigError(f"{key}: a search has one objective; one value is allowed")
    paying = [key for key in sampled if _setting(key).split(".")[0] == "rewards"]
    words = [word for word in fixed if not (paying and _setting(word).startswith("rewards."))]
    lists = {key: values for key, values in sampled.items() if not isinstance(values, Interval)}
    # Of the lists, an experiment alone changes the objective; of others, the first value stands.
    first = [f"{key}={values[0]}" for key, values in lists.items() if key != _EXPERIMENT]
    objectives: dict[bool, str] = {}
    for experiment in lists.get(_EXPERIMENT, [None]):
        choice = [] if experiment is None else [f"{_EXPERIMENT}={experiment}"]
        for one in compose_train(Overrides.parse([*words, *first, *choice])):
            objectives.setdefault(one.train.best_by == "return", " ".join(choice))
    if paying and True in objectives:
        raise ConfigError(
            f"{paying[0]}: a search by returns (train.best_by=return) would find the rewards that "
            "pay most, not those that teach best; search with train.best_by=success"
        )
    if len(objectives) > 1:
        *_, other = objectives.values()
        raise ConfigError(
            f"{other}: a search has one objective, but this changes train.best_by; give that a "
            "value of its own"
        )


def _setting(word: str) -> str:
    """Return the setting of an override or its key, as in ``+reward@rewards.blow=impact``."""
    return word.partition("=")[0].lstrip("+~").rpartition("@")[2]
