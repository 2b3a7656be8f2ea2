"""One check of one plugin: a callable that raises what is wrong, where and with which value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from unittest import SkipTest

from flipperctl.api import Plugin
from flipperctl.errors import ConformanceError, FlipperctlError
from flipperctl.guard import error_line, error_place, plugin_label
from flipperctl.testing.variants import Variant


class NotChecked(SkipTest):  # no error: pytest and unittest show it as skipped
    """The check needs a package that is not installed; the text names the extra."""


@dataclass(frozen=True)
class Check:
    """Call it; it returns if the plugin keeps to the contract here."""

    plugin: type[Plugin]
    name: str
    run: Callable[[], None]

    def __call__(self) -> None:
        """Run the check.

        Raises:
            ConformanceError: the plugin fails; the text gives plugin, value and what is allowed.
            NotChecked: what the check needs is not installed.
        """
        try:
            self.run()
        except ConformanceError as error:
            raise ConformanceError(f"{plugin_label(self.plugin)} {error}") from error.__cause__
        except (SkipTest, KeyboardInterrupt):
            raise
        except BaseException as error:  # the plugin's own code may raise anything
            told = _told(error, self.plugin)
            raise ConformanceError(f"{plugin_label(self.plugin)} raises {told}") from error

    def __str__(self) -> str:
        """Kind, plugin and check, as a test's id."""
        name = getattr(self.plugin, "plugin_name", self.plugin.__name__)
        return f"{self.plugin.kind}-{name}-{self.name}"


def over(variants: Sequence[Variant], test: Callable[[Any], None]) -> None:
    """Run a test on every variant; what fails first is told, the others are named.

    Raises:
        ConformanceError: a variant fails, or the plugin's own code raises.
    """
    failed: list[tuple[str, ConformanceError]] = []
    for variant in variants:
        try:
            test(variant.plugin)
        except ConformanceError as error:
            failed.append((variant.label, error))
        except (SkipTest, KeyboardInterrupt):
            raise
        except BaseException as error:  # noqa: BLE001  # the plugin's own code may raise anything
            told = ConformanceError(_told(error, variant.plugin))
            told.__cause__ = error
            failed.append((variant.label, told))
    if failed:
        label, first = failed[0]
        others = ", ".join(label for label, _ in failed[1:])
        more = f" (it fails too with {others})" if others else ""
        raise ConformanceError(f"with {label}: {first}{more}") from first.__cause__


def require(holds: bool, text: str) -> None:
    """Raise the text unless it holds.

    Raises:
        ConformanceError: it does not hold.
    """
    if not holds:
        raise ConformanceError(text)


def _told(error: BaseException, plugin: Plugin | type[Plugin]) -> str:
    """What the plugin's own code raised, and where; the core's own errors say it already."""
    where = "" if isinstance(error, FlipperctlError) else f" ({error_place(error, plugin, '')})"
    return f"{error_line(error)}{where}"
