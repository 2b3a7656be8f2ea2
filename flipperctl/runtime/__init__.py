"""An exported policy on the robot, run with onnxruntime and numpy alone.

This package imports neither torch nor pymunk nor pydantic, so a robot needs only ``numpy``,
``onnxruntime`` and flipperctl without its other dependencies.
"""

from flipperctl.runtime.interface import Interface, Quantity
from flipperctl.runtime.policy import OnnxPolicy
from flipperctl.runtime.targets import TargetRule

__all__ = ["Interface", "OnnxPolicy", "Quantity", "TargetRule"]
