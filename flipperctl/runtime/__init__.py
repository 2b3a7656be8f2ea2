"""An exported policy on the robot, run with onnxruntime and numpy alone.

This package imports neither torch nor pymunk nor pydantic, so a robot needs only ``numpy``,
``onnxruntime`` and flipperctl without its other dependencies.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flipperctl.core.lidar.body import Mount
    from flipperctl.core.targets import TargetRule
    from flipperctl.runtime.answer import Answer
    from flipperctl.runtime.controller import FlipperController
    from flipperctl.runtime.interface import Interface, Quantity
    from flipperctl.runtime.messages import (
        OURS,
        REP_103,
        Attitude,
        Cloud,
        JointAngles,
        NewestJoints,
        Odometry,
        Signs,
    )
    from flipperctl.runtime.point_cloud import PointTimes, read_cloud
    from flipperctl.runtime.policy import OnnxPolicy
    from flipperctl.runtime.setup import Ages, Limits, RobotSetup

__all__ = [
    "OURS",
    "REP_103",
    "Ages",
    "Answer",
    "Attitude",
    "Cloud",
    "FlipperController",
    "Interface",
    "JointAngles",
    "Limits",
    "Mount",
    "NewestJoints",
    "Odometry",
    "OnnxPolicy",
    "PointTimes",
    "Quantity",
    "RobotSetup",
    "Signs",
    "TargetRule",
    "read_cloud",
]

_MODULES = {
    "Answer": "flipperctl.runtime.answer",
    "FlipperController": "flipperctl.runtime.controller",
    "Attitude": "flipperctl.runtime.messages",
    "Cloud": "flipperctl.runtime.messages",
    "JointAngles": "flipperctl.runtime.messages",
    "Odometry": "flipperctl.runtime.messages",
    "NewestJoints": "flipperctl.runtime.messages",
    "PointTimes": "flipperctl.runtime.point_cloud",
    "read_cloud": "flipperctl.runtime.point_cloud",
    "Ages": "flipperctl.runtime.setup",
    "Limits": "flipperctl.runtime.setup",
    "RobotSetup": "flipperctl.runtime.setup",
    "Signs": "flipperctl.runtime.messages",
    "OURS": "flipperctl.runtime.messages",
    "REP_103": "flipperctl.runtime.messages",
    "Mount": "flipperctl.core.lidar.body",
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
