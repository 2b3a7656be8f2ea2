"""Starts the node in shadow mode: it logs what it would do, and commands nothing."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource


def generate_launch_description():
    """Return the robot's launch file with ``shadow``; its other arguments pass."""
    robot = PythonLaunchDescriptionSource(str(Path(__file__).with_name("robot.launch.py")))
    shadow = IncludeLaunchDescription(robot, launch_arguments={"shadow": "true"}.items())
    return LaunchDescription([shadow])
