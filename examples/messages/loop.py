"""A control loop around an exported policy, for a robot whose driver has its own map of the ground.

    python examples/messages/loop.py varied.onnx

``StandIn`` takes the place of the robot's driver. ``FlipperController`` does all this by itself
where clouds, attitude, joint angles and belt speeds are at hand.
"""

import sys
import time

from flipperctl.errors import FlipperctlError
from flipperctl.runtime import OnnxPolicy


class StandIn:
    """Replace this by your robot's driver; this one stands on level ground for two decisions."""

    def __init__(self) -> None:
        self.angles, self.decisions = [0.0, 0.0], 0

    def scan(self) -> list[list[float]]:
        """Return points of the ground, x forward and z up from the chassis centre, level [m]."""
        return [[0.02 * i, -0.1] for i in range(-75, 76)]  # 0.1 m below the chassis centre

    def pitch(self) -> float:
        """Return the pitch, nose up positive [rad]."""
        return 0.0

    def drive(self, speed: float) -> None:
        """Move all belts at this speed [m/s]."""

    def turn_to(self, targets: list[float]) -> None:
        """Turn the flippers to these angles [rad] at the speed that the metadata state."""
        self.angles, self.decisions = list(targets), self.decisions + 1

    def running(self) -> bool:
        """Return whether the operator wants the robot to drive ahead."""
        return self.decisions < 2


policy, robot = OnnxPolicy(sys.argv[1]), StandIn()
policy.reset()
targets = robot.angles
while robot.running():
    due = time.monotonic() + policy.interface.decision_period
    try:
        front, rear = robot.angles
        seen = policy.observation(robot.scan(), front=front, rear=rear, pitch=robot.pitch())
        action = policy.act(seen)
        targets = policy.next_targets(targets, robot.angles, action)
        robot.drive(policy.interface.robot["track_speed"])
    except FlipperctlError as error:  # a number is missing or not plausible
        robot.drive(0.0)  # and hold the last targets
        policy.reset()  # it begins anew with belts that drive
        print(error)
    robot.turn_to(targets)
    time.sleep(max(0.0, due - time.monotonic()))
robot.drive(0.0)
