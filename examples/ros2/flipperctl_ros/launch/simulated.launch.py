"""Starts a simulated robot and the node: ros2 launch flipperctl_ros simulated.launch.py.

``flipperctl`` with the extras mujoco and ros must be on the path, see the README.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    """Return the simulated robot on ``terrain``, and the robot's launch file."""
    robot = PythonLaunchDescriptionSource(str(Path(__file__).with_name("robot.launch.py")))
    devices = LaunchConfiguration("devices")
    simulate = ExecuteProcess(
        cmd=[
            *("flipperctl", "robot", "simulate", "sim=mujoco"),
            ["terrain=", LaunchConfiguration("terrain")],
            ["robot=", LaunchConfiguration("robot")],
            ["devices=", devices],
        ],
        output="screen",
    )
    here = Path(__file__).parents[1]
    default = str(here / "config" / "nubot.yaml")
    return LaunchDescription(
        [
            DeclareLaunchArgument("terrain", default_value="paper_step"),
            DeclareLaunchArgument("robot", default_value="nubot"),
            DeclareLaunchArgument("devices", default_value=default),
            simulate,
            IncludeLaunchDescription(
                robot, launch_arguments={"devices": devices, "enabled": "true"}.items()
            ),
        ]
    )
