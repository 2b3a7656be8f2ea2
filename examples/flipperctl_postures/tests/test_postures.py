"""``postures`` keeps to flipperctl's contract."""

from flipperctl.testing import Conformance
from flipperctl_postures import Postures


class TestPostures(Conformance):
    """At its defaults and at the bounds of each of its fields."""

    plugin = Postures
