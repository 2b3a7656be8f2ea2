"""What tests of results made by hand share."""

import pytest

from flipperctl import api
from flipperctl.env.metrics import CORE


@pytest.fixture
def core_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the measures that a result made by hand has, whatever else is built in."""
    for kind, name in list(api.registry):
        if kind == api.Measure.kind and name not in CORE:
            monkeypatch.delitem(api.registry, (kind, name))
