"""``trunk`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_trunk import Trunk


class TestTrunk(Conformance):
    """At its defaults and at the bounds of each of its fields."""

    plugin = Trunk
