"""Our sweepers as Hydra's plugins: the module ``hydra_plugins.flipperctl_sweepers``.

Hydra imports every module of the namespace package ``hydra_plugins`` and registers the plugins
that it defines, in any application that is installed beside flipperctl. So this module imports
nothing but Hydra; the sweeps themselves are in ``flipperctl.cli``. Never import this module as part
of ``flipperctl.cli``: Hydra identifies the classes by the module's name.
"""

from __future__ import annotations

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class ListSweeper(Sweeper):
    """Hydra's basic sweeper, with named folders and a table at the end."""

    kind = "list_sweep"
    """Function in ``flipperctl.cli.hydra.sweeps``."""

    def __init__(self, **settings: Any) -> None:
        """Keep the settings until ``setup``, since Hydra rewords errors raised before it."""
        self._settings = settings
        self._run: Any = None

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Prepare the sweep; Hydra calls this before ``sweep``."""
        from flipperctl.cli.hydra import sweeps

        self._run = getattr(sweeps, self.kind)(
            self._settings, hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> None:
        """Train what ``arguments``, the user's overrides, describe."""
        self._run(arguments)


class OptunaSweeper(ListSweeper):
    """A search by Optuna over intervals and lists."""

    kind = "search_sweep"
