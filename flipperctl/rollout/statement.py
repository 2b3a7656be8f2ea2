"""Statements of code and files; each worker compares itself with the process that it works for.

In: the loaded plugins, a configuration's plugins and their files. Out: a ``Statement`` of versions
and SHA-256. A worker enters it before it computes anything, since the results of other code or
other files would pass for right ones.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from flipperctl.api import Controller, Plugin
from flipperctl.checkpoint import find
from flipperctl.config import EnvConfig
from flipperctl.config.identity import all_files_read, content_digest
from flipperctl.env.metrics import measures
from flipperctl.errors import FlipperctlError, WorkerDiffersError
from flipperctl.plugging import plugins
from flipperctl.plugging.guard import OWN
from flipperctl.rollout import cluster
from flipperctl.sim.versions import engine_versions

_PACKAGES = (*OWN, "flipperctl.configs")
_SUFFIXES = (".py", ".yaml")
_PYTHON, _LIBRARIES = "Python", ("flipperctl", "numpy", "torch", "pymunk", "numba", "mujoco")
_DIGITS = 12  # of a SHA-256 in an error


@cache
def package_files(package: str) -> Mapping[str, str | None]:
    """Return the SHA-256 of each Python and YAML file of a package, by its name below ``package``.

    The files are read at the first call, soon after the process has imported them.
    """
    spec = find_spec(package)
    if spec is None:
        return {}
    if spec.submodule_search_locations is None:  # a module alone
        return {f"{package}.py": content_digest(Path(str(spec.origin)))}
    folders = [Path(folder) for folder in spec.submodule_search_locations]
    files = ((folder, file) for folder in folders for file in sorted(folder.rglob("*")))
    return {
        f"{package}/{file.relative_to(folder)}": content_digest(file)
        for folder, file in files
        if file.suffix in _SUFFIXES
    }


@dataclass(frozen=True)
class Statement:
    """What a process computes with."""

    entries: Mapping[str, str]
    """Versions by libraries, SHA-256 by absolute paths of files or their names in packages."""
    plugins: tuple[str, ...] | None = None
    """Paths of all plugins in a statement on the whole code; None in one on inputs alone."""

    @classmethod
    def of_code(cls) -> Statement:
        """Return the statement on the code of this process: libraries, packages and plugins."""
        # Installed packages with plugins belong to the code as well.
        installed = {entry.module.partition(".")[0] for entry in plugins.installed(plugins.GROUP)}
        packages = dict.fromkeys([*_PACKAGES, *sorted(installed)])
        names = [
            _PYTHON,
            *_LIBRARIES,
            *(file for package in packages for file in package_files(package)),
        ]
        loaded = {str(file): digest for file, digest in plugins.loaded_contents().items()}
        return cls(_states(names) | loaded, tuple(plugins.configured_paths()))

    @classmethod
    def of_inputs(cls, config: EnvConfig, *others: Plugin | Path | None) -> Statement:
        """Return the statement on what episodes of an environment need beyond code.

        These are the libraries of the engine, and the files that its plugins and ``others`` read.
        """
        # Whatever episodes read: plugins of the environment, of the policy, and their files.
        plugged = [config.terrain, config.sim, config.perception, *config.rewards.values()]
        plugged += [*measures().values(), *(value for value in others if isinstance(value, Plugin))]
        files = [*all_files_read(plugged), *(value for value in others if isinstance(value, Path))]
        for controller in (value for value in others if isinstance(value, Controller)):
            files += [find(Path(named)) for named in controller.uses().values()]
        return cls(_states([*engine_versions(config.sim), *(str(f.absolute()) for f in files)]))

    def enter(self) -> None:
        """Load the plugins in a worker, which must agree with this statement of another process.

        Raises:
            WorkerDiffersError: a version or file differs, is missing here, or is here alone.
        """
        # Before any plugin runs, since another one may fail in its own way.
        self._require(_states(self.entries))
        if self.plugins is not None:
            try:
                plugins.load(self.plugins)
            except FlipperctlError as error:
                raise WorkerDiffersError(f"the worker on {cluster.node()}: {error}") from error
            self._require(Statement.of_code().entries)

    def _require(self, here: Mapping[str, str]) -> None:
        # All that is stated must be equal in the worker; what it has besides counts if it may run.
        names = [name for name in self.entries if here.get(name) != self.entries[name]]
        places = {Path(path).resolve() for path in self.plugins or ()}
        alone = [Path(name) for name in sorted(here.keys() - self.entries.keys())]
        # A process may have served another command, whose plugins and libraries do no harm.
        names += [
            str(file)
            for file in alone
            if file.suffix in _SUFFIXES and (not file.is_absolute() or file.parent in places)
        ]
        if names:
            name, more = names[0], f"; {len(names) - 1} more differ" if names[1:] else ""
            raise WorkerDiffersError(
                f"the worker on {cluster.node()} has other code or files than this command: "
                f"{name} is {_short(here, name)} there and {_short(self.entries, name)} here{more}"
            )


def _states(names: Iterable[str]) -> dict[str, str]:
    """Return the version or SHA-256 that each of the names has in this process, if it has one."""
    states = {name: _state(name) for name in names}
    return {name: state for name, state in states.items() if state is not None}


def _state(name: str) -> str | None:
    if Path(name).is_absolute():
        return content_digest(Path(name))
    if Path(name).suffix in _SUFFIXES:
        return package_files(Path(name).parts[0].removesuffix(".py")).get(name)
    try:
        return platform.python_version() if name == _PYTHON else version(name)
    except PackageNotFoundError:
        return None


def _short(entries: Mapping[str, str], name: str) -> str:
    return entries[name][:_DIGITS] if name in entries else "missing"
