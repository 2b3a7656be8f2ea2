"""``hydra/sweeper=optuna``: a search over intervals and lists that resumes after any stop.

In: overrides, of which some are ``interval(…)``, ``tag(log,interval(…))`` or lists. Out: one
training for each trial. Optuna proposes, Hydra's launcher trains. (Hydra's own plugin,
hydra-optuna-sweeper 1.3, needs Optuna 2, whose storage fails with SQLAlchemy 2, and repeats every
trial after a restart.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig
from pydantic import ValidationError

from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.hydra.search_space import search_space
from flipperctl.cli.hydra.sweeps import SweepLauncher, command_to_go_on, uses_default_naming
from flipperctl.errors import ConfigError, MissingExtraError
from flipperctl.messages import explain
from flipperctl.runs.optuna_search import OptunaSearch
from flipperctl.runs.search import SearchSettings
from flipperctl.runs.study import open_study
from flipperctl.terminal.streams import print_note


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
    try:
        import optuna
    except ImportError as error:
        raise MissingExtraError(
            "hydra/sweeper=optuna needs the package optuna; install flipperctl[optuna]"
        ) from error
    try:
        settings = SearchSettings(**sweeper_settings)
    except ValidationError as error:
        raise ConfigError(explain(error, "hydra.sweeper", SearchSettings)) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    launcher = Plugins.instance().instantiate_launcher(
        config=config, hydra_context=hydra_context, task_function=task_function
    )
    folder = Path(config.hydra.sweep.dir)
    jobs = SweepLauncher(launcher, folder, named=uses_default_naming(config))
    return SearchSweep(settings, jobs, folder)


@dataclass(frozen=True)
class SearchSweep:
    """A search whose trials are jobs of Hydra."""

    settings: SearchSettings
    jobs: SweepLauncher
    folder: Path
    """Folder of the sweep."""

    def run(self, arguments: Sequence[str]) -> None:
        """Train trial after trial; ``arguments`` are the user's overrides.

        Raises:
            RunHeldError: another process works in the sweep's folder.
        """
        space, fixed = search_space(Overrides.parse(arguments, check=False))
        study = open_study(self.settings, arguments)
        self.jobs.swept = list(space)
        search = OptunaSearch(
            *(self.settings, study, self.jobs, space, fixed),
            tell=print_note,
            command_to_go_on=lambda: command_to_go_on(self.folder),
        )
        with self.jobs.held():
            search.run()
        search.conclude(self.folder)
