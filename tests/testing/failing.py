"""A plugin that fails a check of the conformance suite."""

import pytest

from flipperctl import api
from flipperctl.errors import ConformanceError
from flipperctl.testing import checks


def failure(cls: type[api.Plugin], name: str) -> str:
    """Return the error of the named check of a plugin that is registered for this test only."""
    cls.plugin_name = "mine"
    api.registry[cls.kind, "mine"] = cls
    (one,) = [c for c in checks(cls) if c.name == name]
    with pytest.raises(ConformanceError) as error:
        one()
    return str(error.value)
