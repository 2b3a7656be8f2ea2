"""An exported policy on the robot, run with onnxruntime and numpy alone.

This package imports neither torch nor pymunk nor pydantic, so a robot needs only ``numpy``,
``onnxruntime`` and flipperctl without its other dependencies.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flipperctl.core.targets import TargetRule
    from flipperctl.runtime.interface import Interface, Quantity
    from flipperctl.runtime.policy import OnnxPolicy

__all__ = ["Interface", "OnnxPolicy", "Quantity", "TargetRule"]

_MODULES = {
    "Interface": "flipperctl.runtime.interface",
    "OnnxPolicy": "flipperctl.runtime.policy",
    "Quantity": "flipperctl.runtime.interface",
    "TargetRule": "flipperctl.core.targets",
}


def __getattr__(name: str) -> object:
    """Import a name on first use, so that ``__main__`` can handle Ctrl-C before."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_MODULES[name]), name)
