"""Test that ``postures`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_postures import Postures


class TestPostures(Conformance):
    """Check the plugin at its defaults and at the bounds of each field."""

    plugin = Postures
