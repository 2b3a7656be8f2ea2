"""Versions of the libraries that affect an engine's results, for files."""

from __future__ import annotations

from collections.abc import Mapping

from flipperctl.api import Engine
from flipperctl.guard import naming, refusal, short_repr


def engine_versions(engine: Engine) -> dict[str, str]:
    """Return the versions of the libraries that affect the engine's results.

    Raises:
        PluginFailedError: the engine's code failed, or returned no mapping of text to text.
    """
    with naming(engine, "versions"):  # the returned object's code may fail too
        found: object = engine.versions()
        versions = dict(found) if isinstance(found, Mapping) else {}
    texts = all(isinstance(text, str) for item in versions.items() for text in item)
    if not (isinstance(found, Mapping) and texts):
        text = f"returned {short_repr(found)}; allowed: a mapping of names to texts"
        raise refusal(engine, "versions", text)
    return versions
