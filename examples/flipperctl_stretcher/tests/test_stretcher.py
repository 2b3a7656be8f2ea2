"""``stretcher`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_stretcher import Stretcher


class TestStretcher(Conformance):
    """At its defaults and at the bounds of each of its fields."""

    plugin = Stretcher
