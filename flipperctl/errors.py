"""Every exception that flipperctl raises on purpose.

``RequestError`` and its children mean that the request was wrong (exit code 2); any other
``FlipperctlError`` means that the work failed (exit code 1).

Plugins: one that is refused before it works (it does not import, cannot be made from its settings,
builds no network that fits, generates no profile that a robot can start on) is a wrong request;
one that fails at work, by what it raises or returns, is failed work.

Each takes its text and nothing else, so that it comes back whole from a worker process.
"""

from __future__ import annotations


class FlipperctlError(Exception):
    """Root of the package's own exceptions; its text is shown to the user as it is."""

    exit_code = 1


class RequestError(FlipperctlError):
    """What was asked for cannot be done as asked."""

    exit_code = 2


class ConfigError(RequestError):
    """A configuration value is unknown, of the wrong type or out of bounds."""


class PluginError(RequestError):
    """A plugin is missing, does not import, takes a name twice, or cannot be made."""


class TerrainError(RequestError):
    """A terrain generator returned a profile that no robot can start on."""


class CheckpointError(RequestError):
    """A checkpoint is missing, damaged, foreign, or needs a plugin that is not installed."""


class PolicyError(RequestError):
    """An exported policy is missing, damaged or foreign, or was fed what it does not take."""


class OutputError(RequestError):
    """A path asked for cannot be written."""


class RunHeldError(RequestError):
    """Another process is working in the run directory; the text says which."""


class MissingExtraError(RequestError):
    """An optional dependency is not installed; the text names the extra."""


class PluginFailedError(FlipperctlError):
    """A plugin's code raised, or returned what the contract does not allow."""


class NonFiniteError(FlipperctlError):
    """A state, reward or loss is not a finite number; the text says where it came from."""


class ConformanceError(FlipperctlError, AssertionError):
    """A plugin does not keep to the contract; an assertion too, for those who test theirs."""


class ExportError(FlipperctlError):
    """An exported policy does not agree with the trained one."""


class WriteError(FlipperctlError):
    """Writing failed half way (a full disk, say); what was there before is untouched."""


class InterruptedRunError(FlipperctlError):
    """The user interrupted the work; what was done so far is saved."""

    exit_code = 130
