"""What every test shares: the built-in plugins, and a registry that is put back."""

from collections.abc import Iterator

import pytest

from flipperctl import api, plugins

plugins.load()  # at import, since tests are parametrised over the registry


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict]:
    """The plugin registry; what a test registers or loads is forgotten behind it."""
    before = dict(api.registry)
    monkeypatch.setattr(plugins, "_loaded", set(plugins._loaded))
    monkeypatch.setenv(plugins.VARIABLE, "")
    yield api.registry
    api.registry.clear()
    api.registry.update(before)
