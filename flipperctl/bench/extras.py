"""Optional packages that a measure needs, and the words for one that is missing."""

from __future__ import annotations

import importlib
from types import ModuleType

from flipperctl.errors import MissingExtraError


def extra(module: str, package: str, name: str) -> ModuleType:
    """A module that needs an optional package.

    Raises:
        MissingExtraError: it is not installed; the text names flipperctl's extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{package} is not installed; install flipperctl[{name}]"
        ) from error
