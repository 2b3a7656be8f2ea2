"""All exceptions that flipperctl raises on purpose.

``RequestError`` and its subclasses mean that the request was wrong (exit code 2); any other
``FlipperctlError`` means that the work failed (exit code 1).

A plugin that is refused before it is used is a wrong request. It does not import, cannot be built
from its settings, builds a network that does not fit, or generates a profile that no robot can
start on. A plugin that raises an error or returns a wrong value in use is failed work.

Each exception takes its text and nothing else, so that it can be pickled by a worker process.
"""

from __future__ import annotations

import re
from typing import Any


class FlipperctlError(Exception):
    """Base class of the package's own exceptions; its text is shown to the user unchanged."""

    exit_code = 1
    result: Any = None
    """Of ``flipperctl.evaluate``: the ``Evaluation`` with what was played; None if nothing was."""

    def __str__(self) -> str:
        """Return the text, and the notes that were added to it, such as the episode's seed."""
        return "; ".join([super().__str__(), *getattr(self, "__notes__", ())])


class RequestError(FlipperctlError):
    """The request cannot be carried out as given."""

    exit_code = 2


class ConfigError(RequestError):
    """A configuration value is unknown, of the wrong type or out of bounds."""


class PluginError(RequestError):
    """A plugin is missing, does not import, uses a taken name, or cannot be built."""


class TerrainError(RequestError):
    """A terrain generator returned a profile that no robot can start on."""


class CheckpointError(RequestError):
    """A checkpoint is missing, damaged, foreign, or needs a plugin that is not installed."""


class PolicyError(RequestError):
    """An exported policy is missing, damaged or foreign, or received an input that does not fit."""


class OutputError(RequestError):
    """A requested path cannot be written."""


class RunHeldError(RequestError):
    """Another process is working in the run directory; the text says which."""


class MissingExtraError(RequestError):
    """An optional dependency is not installed; the text names the extra."""


class WorkerDiffersError(RequestError):
    """A worker has other code, plugins or files than its driver; the text names place and file."""


class PluginFailedError(FlipperctlError):
    """A plugin's code raised an error, or returned a value that the contract does not allow."""


class NonFiniteError(FlipperctlError):
    """A state, reward or loss is not a finite number; the text says where it came from."""


class ConformanceError(FlipperctlError, AssertionError):
    """A plugin violates the contract; an AssertionError too, so that its author's tests fail."""


class ExportError(FlipperctlError):
    """An exported policy does not agree with the trained one."""


class WriteError(FlipperctlError):
    """Writing failed half way, as on a full disk; an earlier file, if any, is kept."""


class InterruptedRunError(FlipperctlError):
    """The user interrupted the work; its results so far are saved."""

    exit_code = 130


def other_format(number: object, allowed: int) -> str:
    """Return the text, which follows a file's name, for a file of another format."""
    return (
        f"its format is {number!r:.40}, of another version of flipperctl; this one reads "
        f"{allowed}; train or record again, or use that version"
    )


_PACKAGES = {"PIL": "pillow", "hydra": "hydra-core", "yaml": "pyyaml"}
"""Module → the package that has it, where they differ."""


def missing_package(error: BaseException) -> str:
    """Return how to install the package whose module an import does not find; else no text."""
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return ""
    module = error.name.partition(".")[0]
    return f"the package {module} is missing: {installing(_PACKAGES.get(module, module))}"


def missing_extra(what: str, package: str) -> MissingExtraError:
    """Return the error for what needs a package that is not installed."""
    return MissingExtraError(f"{what} needs {package}: {installing(package)}")


def installing(package: str) -> str:
    """Return the command that installs a package: by the extra of flipperctl that has it."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        requirements = requires("flipperctl") or []
    except PackageNotFoundError:  # files without an installation
        requirements = []
    # Such as 'mujoco<5,>=3.11; extra == "mujoco"'; what is installed always has no extra.
    for requirement in requirements:
        name, *_ = re.split(r"[^\w.-]", requirement, maxsplit=1)
        extra = re.search(r"""extra == ['"]([\w-]+)""", requirement)
        if _plain(name) == _plain(package):
            return f"pip install 'flipperctl[{extra[1]}]'" if extra else f"pip install {package}"
    return f"pip install {package}"


def _plain(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()
