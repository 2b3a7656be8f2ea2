"""An exported policy on the robot, with onnxruntime and numpy alone.

Neither torch nor pymunk nor pydantic is imported, so a robot needs ``numpy``, ``onnxruntime`` and
this package without its other dependencies.
"""

from flipperctl.runtime.interface import Interface, Quantity
from flipperctl.runtime.policy import OnnxPolicy

__all__ = ["Interface", "OnnxPolicy", "Quantity"]
