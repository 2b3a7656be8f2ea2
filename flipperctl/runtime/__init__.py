"""An exported policy on the robot, run with onnxruntime and numpy alone.

This package imports neither torch nor pymunk nor pydantic, so a robot needs only ``numpy``,
``onnxruntime`` and flipperctl without its other dependencies.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flipperctl.core.lidar.body import Mount as Mount
    from flipperctl.core.targets import TargetRule as TargetRule
    from flipperctl.runtime.controller import Answer as Answer
    from flipperctl.runtime.controller import FlipperController as FlipperController
    from flipperctl.runtime.devices import Devices as Devices
    from flipperctl.runtime.devices import read_devices as read_devices
    from flipperctl.runtime.interface import Interface as Interface
    from flipperctl.runtime.interface import Quantity as Quantity
    from flipperctl.runtime.lockstep import Lockstep as Lockstep
    from flipperctl.runtime.markers import Marker as Marker
    from flipperctl.runtime.markers import markers_of as markers_of
    from flipperctl.runtime.messages import OURS as OURS
    from flipperctl.runtime.messages import REP_103 as REP_103
    from flipperctl.runtime.messages import Ages as Ages
    from flipperctl.runtime.messages import Attitude as Attitude
    from flipperctl.runtime.messages import Cloud as Cloud
    from flipperctl.runtime.messages import JointAngles as JointAngles
    from flipperctl.runtime.messages import Limits as Limits
    from flipperctl.runtime.messages import NewestJoints as NewestJoints
    from flipperctl.runtime.messages import Odometry as Odometry
    from flipperctl.runtime.messages import RobotSetup as RobotSetup
    from flipperctl.runtime.messages import Signs as Signs
    from flipperctl.runtime.node import Command as Command
    from flipperctl.runtime.node import Diagnosis as Diagnosis
    from flipperctl.runtime.node import Place as Place
    from flipperctl.runtime.node import RobotNode as RobotNode
    from flipperctl.runtime.point_cloud import PointTimes as PointTimes
    from flipperctl.runtime.point_cloud import read_cloud as read_cloud
    from flipperctl.runtime.policy import OnnxPolicy as OnnxPolicy
    from flipperctl.runtime.states import CommandWatch as CommandWatch

_MODULES = {
    "controller": "Answer FlipperController",
    "devices": "Devices read_devices",
    "interface": "Interface Quantity TargetRule",
    "messages": "OURS REP_103 Ages Attitude Cloud JointAngles Limits Mount NewestJoints Odometry "
    "RobotSetup Signs",
    "lockstep": "Lockstep",
    "markers": "Marker markers_of",
    "node": "Command Diagnosis Place RobotNode",
    "point_cloud": "PointTimes read_cloud",
    "policy": "OnnxPolicy",
    "states": "CommandWatch",
}
__all__ = sorted(name for names in _MODULES.values() for name in names.split())


def __getattr__(name: str) -> object:
    """Import a name on first use, so that ``__main__`` can handle Ctrl-C before."""
    for module, names in _MODULES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
