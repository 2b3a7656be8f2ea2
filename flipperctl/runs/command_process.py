"""The state of a command's process that its jobs in other processes restore."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl import plugins
from flipperctl import results as lock
from flipperctl.runs import follow_up


@dataclass(frozen=True)
class CommandProcess:
    """Plugins, working directory and identity of a command's process; picklable."""

    plugins: list[str]
    """Paths of all plugin files and folders."""
    typed: list[str]
    """Those among them that ``--plugins`` named."""
    folder: Path
    """Working directory, which is another one in a worker of a running cluster."""
    holder: dict[str, Any]
    """The process (``lock.holder``), whose death a job notices."""

    @classmethod
    def current(cls) -> CommandProcess:
        """Return this process."""
        typed = follow_up.plugin_paths()
        return cls(plugins.configured_paths(), typed, Path.cwd(), lock.holder())

    def restore(self) -> None:
        """Load the plugins in a job, and enter the working directory if it exists.

        A job of Hydra leaves it with ``hydra.job.chdir=true``, but the user's paths start there.
        """
        if self.folder.is_dir():
            os.chdir(self.folder)
        plugins.load(self.plugins)
        follow_up.remember_plugins(self.typed)
