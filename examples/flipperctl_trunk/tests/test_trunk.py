"""Test that ``trunk`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_trunk import Trunk


class TestTrunk(Conformance):
    """Check the plugin at its defaults and at the bounds of each field."""

    plugin = Trunk
