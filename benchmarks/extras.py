"""Import of optional packages that a measure needs."""

from __future__ import annotations

import importlib
from types import ModuleType

from flipperctl.errors import MissingExtraError


def import_extra(module: str, package: str, name: str) -> ModuleType:
    """Import a ``module`` that needs an optional ``package``, which the extra ``name`` installs.

    Raises:
        MissingExtraError: the package is not installed; the text names flipperctl's extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{package} is not installed; install flipperctl[{name}]"
        ) from error
