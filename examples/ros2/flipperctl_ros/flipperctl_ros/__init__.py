"""A lifecycle node around ``flipperctl.runtime``."""

from rclpy.clock import Clock, ClockType


def wake(node):
    """Let a node look each second, by no simulated clock, whether it shall end.

    A signal that arrives while messages do may wake no wait: 2 of 64 nodes without a timer went on.
    """
    return node.create_timer(1.0, lambda: None, clock=Clock(clock_type=ClockType.STEADY_TIME))
