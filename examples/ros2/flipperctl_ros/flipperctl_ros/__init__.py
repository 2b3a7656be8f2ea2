"""A lifecycle node around ``flipperctl.runtime``."""

import signal
import threading

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

LOOK = 0.5
"""Longest time after which a signal is seen while no message comes [s]."""


def spin_until_stopped(make):
    """Run the node that ``make`` returns until SIGINT or SIGTERM; None instead of a node ends it.

    A signal ends it between two callbacks. rclpy's own handlers, and Python's, would end it while
    a message is taken, by exceptions that depend on the place.
    """
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        executor = SingleThreadedExecutor()
        if (node := make()) is None:
            return False
        executor.add_node(node)
        while not stopped.is_set():
            executor.spin_once(timeout_sec=LOOK)
    finally:
        rclpy.try_shutdown()
    return True
