"""``near_far`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_near_far import NearFar


class TestNearFar(Conformance):
    """At its defaults and at the bounds of each of its fields."""

    plugin = NearFar
