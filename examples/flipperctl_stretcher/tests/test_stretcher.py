"""Test that ``stretcher`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_stretcher import Stretcher


class TestStretcher(Conformance):
    """Check the plugin at its defaults and at the bounds of each field."""

    plugin = Stretcher
