"""The conformance suite with which plugin authors test that a plugin fulfils its contract.

Two lines in a test file are enough:

    class TestRidge(Conformance):
        plugin = Ridge

or, for several plugins at once, ``@pytest.mark.parametrize("check", checks(Ridge, Gap), ids=str)``
over ``def test_mine(check): check()``. ``package_checks(my_package)`` has the checks of all
plugins of a package. ``flipperctl inspect plugins --check`` runs the same checks on all installed
plugins.
"""

from flipperctl.errors import ConformanceError
from flipperctl.testing.check import Check, Conformance, NotChecked, checks, package_checks

__all__ = ["Check", "Conformance", "ConformanceError", "NotChecked", "checks", "package_checks"]
