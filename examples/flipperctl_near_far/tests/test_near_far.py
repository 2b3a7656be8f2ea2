"""Test that ``near_far`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_near_far import NearFar


class TestNearFar(Conformance):
    """Check the plugin at its defaults and at the bounds of each field."""

    plugin = NearFar
